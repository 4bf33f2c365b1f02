"""Custom contracts: ``[tool.envcraft.contracts.NAME]`` in ``pyproject.toml``. Errors name the setting."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import msgspec

from envcraft.config import settings
from envcraft.errors import UsageError
from envcraft.model.contract import OPTIONAL, Contract, Success
from envcraft.registry import did_you_mean

#: Words for the JSON types that msgspec names.
_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}


#: What a table may leave out of a space: the defaults of Gymnasium's constructors.
_DEFAULTS: dict[str, dict[str, Any]] = {
    "Box": {"low": -math.inf, "high": math.inf, "dtype": "float32"},
    "Text": {"min_length": 1, "charset": string.ascii_letters + string.digits},
    "Sequence": {"stack": False},
    "Graph": {"edges": None},
}

#: The values of `render`.
_RENDER = {"required": True, "optional": OPTIONAL, "off": False, True: True, False: False}


class Table(msgspec.Struct, forbid_unknown_fields=True, rename="kebab"):
    """The settings of a contract's table. Settings that are left out come from the contract `base`."""

    base: str = "gymnasium"
    summary: str | None = None
    observation: dict[str, Any] | None = None
    action: dict[str, Any] | None = None
    limit: int | None = None
    reward_range: tuple[float, float] | None = None
    noop: Any = None
    render: bool | str | None = None
    libraries: list[str] | None = None
    project: bool | None = None
    resize: tuple[int, int] | None = None
    cut: int | None = None
    success: str | None = None
    success_by_sign: bool | None = None
    without: list[str] | None = None
    consistently: float | None = None
    min_steps_per_second: float | None = None
    at_once: int | None = None


def custom_contracts(
    folder: Path, known: Iterable[Contract], rules: Callable[[], Iterable[str]] | None = None
) -> list[Contract]:
    """Read the contracts that the nearest ``pyproject.toml`` defines.

    Args:
        folder: where the search for ``pyproject.toml`` starts.
        known: the contracts that a table may name as its base.
        rules: returns the codes of all rules, to check the codes in ``without``; None skips this.

    Raises:
        UsageError: a table is not valid, or its name is taken.
    """
    bases = {contract.name: contract for contract in known}
    path, tables = _tables(folder)
    refuse_taken(folder, bases)
    found: list[Contract] = []
    for name, own in tables.items():
        place = f"{path}: [tool.envcraft.contracts.{name}]"
        try:
            found.append(_contract(name, own, bases, rules))
        except (ValueError, msgspec.ValidationError) as error:
            raise UsageError(f"{place}: {error}") from None
    return found


def valid_contract(contract: Contract) -> Contract:
    """Return a plugin's contract, its spaces with the defaults that a table of pyproject.toml has, too.

    Raises:
        UsageError: a space is not valid, or settings contradict each other.
    """
    try:
        spaces = {
            field: described if (described := getattr(contract, field)) is None else space(described, field)
            for field in ("observation", "action")
        }
        contract = msgspec.structs.replace(contract, **spaces)
        _check(contract)
    except ValueError as error:
        raise UsageError(f"the contract {contract.name} of a plugin is not valid: {error}") from None
    return contract


def refuse_taken(folder: Path, names: Iterable[str]) -> None:
    """Raise UsageError if the nearest ``pyproject.toml`` defines a contract with one of these names."""
    path, tables = _tables(folder)
    for name in names:
        if name in tables:
            place = f"{path}: [tool.envcraft.contracts.{name}]"
            raise UsageError(f'{place}: the name {name} is taken; choose another, with base = "{name}"')


def _tables(folder: Path) -> tuple[Path, dict[str, Any]]:
    """The nearest ``pyproject.toml``, and its table of each contract."""
    path, table = settings(folder)
    tables = table.get("contracts", {})
    if not isinstance(tables, dict):
        raise UsageError(f"{path}: [tool.envcraft.contracts] must hold a table for each contract")
    return path, tables


def _contract(name: str, own: Any, bases: dict[str, Contract], rules: Callable[[], Iterable[str]] | None) -> Contract:
    """Raises ValueError."""
    if isinstance(own, dict):
        own = {key.replace("_", "-"): value for key, value in own.items()}
    table = _convert(own, Table, "")
    if table.base not in bases:
        raise ValueError(f"the base {table.base!r} is not a contract; choose from {', '.join(bases)}")
    base = bases[table.base]
    changes: dict[str, Any] = {"name": name, "summary": table.summary or f"{base.name}, as pyproject.toml changes it"}
    for field in ("observation", "action"):
        if (described := getattr(table, field)) is not None:
            changes[field] = space(described, field)
    for field in ("limit", "reward_range", "noop", "project", "consistently", "min_steps_per_second", "at_once"):
        if (value := getattr(table, field)) is not None:
            changes[field] = value
    if table.render is not None:
        if table.render not in _RENDER:
            raise ValueError(f"render is {table.render!r}; it must be required, optional or off")
        changes["render"] = _RENDER[table.render]
    for field in ("libraries", "without"):
        if (names := getattr(table, field)) is not None:
            changes[field] = tuple(names)
    adapter = {"resize": table.resize and list(table.resize), "limit": table.cut}
    changes["adapter"] = {**base.adapter, **{key: value for key, value in adapter.items() if value is not None}}
    if table.success == "":
        raise ValueError("success is empty; name a key of info, such as is_success, or leave it out")
    by_sign = base.success.sign if table.success_by_sign is None else table.success_by_sign
    changes["success"] = Success(table.success or base.success.key, by_sign)
    contract = msgspec.structs.replace(base, **changes)
    _check(contract)
    if table.without and rules is not None:
        codes = sorted(rules())
        for code in table.without:
            if code not in codes:
                raise ValueError(f"without: there is no rule {did_you_mean(code, codes)}")
    return contract


def space(described: Any, where: str) -> Any:
    """The JSON description of a space in TOML. Raises ValueError, which names the invalid part."""
    if not isinstance(described, dict):
        raise ValueError(f"{where} must be a table, not {described!r}")
    from envcraft.spaces.spec import KINDS

    kind = described.get("type")
    if kind not in KINDS:
        raise ValueError(f"{where}: there is no space {did_you_mean(str(kind), list(KINDS))}")
    fields = {**_DEFAULTS.get(kind, {}), **described}
    for name in ("n", "nvec", "shape"):
        _positive(fields.get(name), f"{where}.{name}")
    if kind == "Dict" and isinstance(fields.get("spaces"), dict):
        fields["spaces"] = [[key, space(item, f"{where}.spaces.{key}")] for key, item in fields["spaces"].items()]
    elif kind in ("Tuple", "OneOf") and isinstance(fields.get("spaces"), list):
        fields["spaces"] = [space(item, f"{where}.spaces[{at}]") for at, item in enumerate(fields["spaces"])]
    for name in ("space", "nodes", "edges"):
        if fields.get(name) is not None:
            fields[name] = space(fields[name], f"{where}.{name}")
    if kind == "Box":
        fields |= _flat_bounds(fields, where)
    _convert(fields, KINDS[kind], where)
    return fields


def _flat_bounds(fields: dict[str, Any], where: str) -> dict[str, Any]:
    """The bounds of a Box, each nested list as a flat one."""
    import numpy as np

    flat: dict[str, Any] = {}
    for side in ("low", "high"):
        if isinstance(fields[side], list):
            try:
                flat[side] = np.broadcast_to(np.asarray(fields[side], np.float64), fields["shape"]).ravel().tolist()
            except (ValueError, TypeError, KeyError):
                raise ValueError(f"{where}.{side} does not fit the shape {fields.get('shape')}") from None
    return flat


def _check(contract: Contract) -> None:
    """Raises ValueError if settings contradict each other."""
    low, high = contract.reward_range
    if not low <= high:
        raise ValueError(f"reward-range: {low:g} is above {high:g}, or not a number")
    for field, value in (("limit", contract.limit), ("at-once", contract.at_once)):
        if value is not None:
            _positive(value, field)
    if not 0 < contract.consistently < 1:
        raise ValueError(f"consistently is {contract.consistently:g}; it must be between 0 and 1")
    if not 0 <= contract.min_steps_per_second < math.inf:
        raise ValueError(f"min-steps-per-second is {contract.min_steps_per_second:g}; it must be 0 or more")
    for code in contract.without:
        if not re.fullmatch(r"[A-Z]+[0-9]+", code):
            raise ValueError(f"without: {code!r} is not a code such as EC505; `envcraft checks` lists them")
    if contract.noop is None:
        return
    if contract.action is None:
        raise ValueError("noop needs action: the action space defines valid actions")
    from envcraft.spaces.spec import read_space
    from envcraft.spaces.validation import validate_action

    if wrong := validate_action(read_space(contract.action), contract.noop):
        raise ValueError(f"noop: {wrong}")


def _positive(value: Any, where: str) -> None:
    """Raises ValueError for a number, or a number in a list, that is not positive."""
    for number in value if isinstance(value, list) else [value]:
        if isinstance(number, int) and number < 1:
            raise ValueError(f"{where} is {value}; it must be 1 or more")


def _convert(value: Any, kind: Any, where: str) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise ValueError(_message(str(error), value, kind, where)) from None


def _message(error: str, value: Any, kind: Any, where: str) -> str:
    """Rewrite an error of msgspec for the author of a TOML file."""
    said, _, path = error.partition(" - at `$")
    path = path.strip(".`")
    prefix = f"{where}: " if where else ""
    if field := re.fullmatch("Object contains unknown field `(.+)`", said):
        names = [one.encode_name for one in msgspec.structs.fields(kind)]
        return f"{prefix}there is no setting {did_you_mean(field[1], names)}"
    if field := re.fullmatch("Object missing required field `(.+)`", said):
        return f"{prefix}{field[1]} is missing"
    if expected := re.fullmatch(r"Expected `(.+?)`( of length \d+)?, got .*", said):
        for key, index in re.findall(r"([\w-]+)|\[(\d+)\]", path):
            value = value[key or int(index)]
        wanted = " or ".join(_KINDS.get(name, name) for name in expected[1].split(" | ") if name != "null")
        place = ".".join(filter(None, (where, path)))
        return f"{place or 'it'} must be {wanted}{expected[2] or ''}, not {value!r}"
    return f"{prefix}{said} at {path}" if path else f"{prefix}{said}"
