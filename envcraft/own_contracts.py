"""Contracts of one's own: ``[tool.envcraft.contracts.NAME]`` in ``pyproject.toml``, read with every mistake named."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, get_args

import msgspec

from envcraft.cli import unknown
from envcraft.contract import Contract, Success
from envcraft.errors import UsageError
from envcraft.pyproject import settings

_DTYPES = (
    "bool",
    *(f"{kind}int{bits}" for kind in ("", "u") for bits in (8, 16, 32, 64)),
    "float16",
    "float32",
    "float64",
)
#: What msgspec calls by the names of JSON, in words.
_KINDS = {
    "int": "a whole number",
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "object": "a table",
}


class _Space(msgspec.Struct, tag_field="type", forbid_unknown_fields=True, kw_only=True):
    """A space as Gymnasium's constructor of that name takes it."""


class Box(_Space, tag="Box", kw_only=True):
    low: float | list[Any] = -math.inf
    high: float | list[Any] = math.inf
    shape: list[int]
    dtype: str = "float32"


class Discrete(_Space, tag="Discrete"):
    n: int
    start: int = 0


class MultiDiscrete(_Space, tag="MultiDiscrete"):
    nvec: list[int]
    start: list[int] | None = None
    dtype: str = "int64"


class MultiBinary(_Space, tag="MultiBinary"):
    shape: list[int]


class Text(_Space, tag="Text"):
    max_length: int
    min_length: int = 1
    charset: str = "".join(sorted("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789"))


class Dict(_Space, tag="Dict"):
    spaces: dict[str, Any]


class Tuple(_Space, tag="Tuple"):
    spaces: list[Any]


class OneOf(_Space, tag="OneOf"):
    spaces: list[Any]


class Sequence(_Space, tag="Sequence"):
    space: Any
    stack: bool = False


class Graph(_Space, tag="Graph"):
    nodes: Any
    edges: Any = None


Space = Box | Discrete | MultiDiscrete | MultiBinary | Text | Dict | Tuple | OneOf | Sequence | Graph


class Table(msgspec.Struct, forbid_unknown_fields=True, rename="kebab"):
    """What a table may set; what it leaves out is as in the contract `base`."""

    base: str = "gymnasium"
    summary: str | None = None
    observation: dict[str, Any] | None = None
    action: dict[str, Any] | None = None
    limit: int | None = None
    reward_range: tuple[float, float] | None = None
    noop: Any = None
    render: bool | None = None
    libraries: list[str] | None = None
    resize: tuple[int, int] | None = None
    cut: int | None = None
    success: str | None = None
    success_by_sign: bool | None = None
    without: list[str] | None = None
    consistently: float | None = None
    at_once: int | None = None


def own_contracts(
    folder: Path, known: Iterable[Contract], rules: Callable[[], Iterable[str]] | None = None
) -> list[Contract]:
    """The contracts that the nearest ``pyproject.toml`` defines on top of those that are `known`. `rules` gives all
    codes, where those that a contract names are to be looked up. Raises UsageError.
    """
    path, table = settings(folder)
    tables = table.get("contracts", {})
    if not isinstance(tables, dict):
        raise UsageError(f"{path}: [tool.envcraft.contracts] must hold a table for each contract")
    bases = {contract.name: contract for contract in known}
    found: list[Contract] = []
    for name, own in tables.items():
        place = f"{path}: [tool.envcraft.contracts.{name}]"
        if name in bases:
            raise UsageError(f"{place}: the name {name} is taken; choose another")
        try:
            found.append(_contract(name, own, bases, rules))
        except (ValueError, msgspec.ValidationError) as error:
            raise UsageError(f"{place}: {error}") from None
    return found


def _contract(name: str, own: Any, bases: dict[str, Contract], rules: Callable[[], Iterable[str]] | None) -> Contract:
    """Raises ValueError."""
    if isinstance(own, dict):
        own = {key.replace("_", "-"): value for key, value in own.items()}
    table = _convert(own, Table, "")
    if table.base not in bases:
        raise ValueError(f"there is no contract {table.base!r} to start from; there are {', '.join(bases)}")
    base = bases[table.base]
    changes: dict[str, Any] = {"name": name, "summary": table.summary or f"{base.name}, as pyproject.toml changes it"}
    for field in ("observation", "action"):
        if (described := getattr(table, field)) is not None:
            changes[field] = space(described, field)
    for field in ("limit", "reward_range", "noop", "render", "consistently", "at_once"):
        if (value := getattr(table, field)) is not None:
            changes[field] = value
    for field in ("libraries", "without"):
        if (names := getattr(table, field)) is not None:
            changes[field] = tuple(names)
    adapter = {"resize": table.resize and list(table.resize), "limit": table.cut}
    changes["adapter"] = {**base.adapter, **{key: value for key, value in adapter.items() if value is not None}}
    by_sign = base.success.sign if table.success_by_sign is None else table.success_by_sign
    changes["success"] = Success(table.success or base.success.key, by_sign)
    contract = msgspec.structs.replace(base, **changes)
    _check(contract)
    if table.without and rules is not None:
        codes = sorted(rules())
        for code in table.without:
            if code not in codes:
                raise ValueError(f"without: there is no rule {unknown(code, codes)}")
    return contract


def space(described: Any, where: str) -> dict[str, Any]:
    """The JSON description of a space in TOML. Raises ValueError, naming the part that is wrong."""
    value = _convert(described, Space, where)
    if isinstance(value, Box):
        return _box(value, where)
    if isinstance(value, Discrete):
        _positive(value.n, f"{where}.n")
    elif isinstance(value, MultiDiscrete):
        for number in value.nvec:
            _positive(number, f"{where}.nvec")
        value.start = value.start or [0] * len(value.nvec)
        if len(value.start) != len(value.nvec):
            raise ValueError(f"{where}.start has {len(value.start)} numbers, and nvec {len(value.nvec)}")
    elif isinstance(value, MultiBinary):
        for number in value.shape:
            _positive(number, f"{where}.shape")
    elif isinstance(value, Text) and not 0 <= value.min_length <= value.max_length:
        raise ValueError(f"{where}: min_length {value.min_length} and max_length {value.max_length} leave no text")
    told: dict[str, Any] = msgspec.to_builtins(value)
    if isinstance(value, Dict):
        told["spaces"] = [[key, space(item, f"{where}.spaces.{key}")] for key, item in value.spaces.items()]
    elif isinstance(value, Tuple | OneOf):
        told["spaces"] = [space(item, f"{where}.spaces[{at}]") for at, item in enumerate(value.spaces)]
    elif isinstance(value, Sequence):
        told["space"] = space(value.space, f"{where}.space")
    elif isinstance(value, Graph):
        told["nodes"] = space(value.nodes, f"{where}.nodes")
        told["edges"] = None if value.edges is None else space(value.edges, f"{where}.edges")
    return told


def _box(value: Box, where: str) -> dict[str, Any]:
    import numpy as np

    for number in value.shape:
        _positive(number, f"{where}.shape")
    if value.dtype not in _DTYPES:
        raise ValueError(f"{where}.dtype is {value.dtype!r}; there are {', '.join(_DTYPES)}")
    sides: dict[str, Any] = {}
    for side in ("low", "high"):
        try:
            numbers = np.asarray(getattr(value, side), dtype=np.float64)
            flat = np.broadcast_to(numbers, value.shape).ravel()
        except (ValueError, TypeError):
            raise ValueError(f"{where}.{side} does not fit the shape {value.shape}") from None
        sides[side] = flat
    if not (sides["low"] <= sides["high"]).all():
        raise ValueError(f"{where}.low is above {where}.high")
    told = {side: flat[0].item() if (flat == flat[0]).all() else flat.tolist() for side, flat in sides.items()}
    return {"type": "Box", **told, "shape": value.shape, "dtype": value.dtype}


def _check(contract: Contract) -> None:
    """Raises ValueError on what does not go together."""
    low, high = contract.reward_range
    if not low <= high:
        raise ValueError(f"reward-range: {low:g} is above {high:g}, or no number")
    for field, value in (("limit", contract.limit), ("at-once", contract.at_once)):
        if value is not None:
            _positive(value, field)
    if not 0 < contract.consistently < 1:
        raise ValueError(f"consistently is {contract.consistently:g}; it is a share, between 0 and 1")
    for code in contract.without:
        if not re.fullmatch(r"[A-Z]+[0-9]+", code):
            raise ValueError(f"without: {code!r} is no code such as EC505; `envcraft checks` lists them")
    if contract.noop is None:
        return
    if contract.action is None:
        raise ValueError("noop needs action: only an action space tells what actions are")
    from envcraft.membership import refuse

    if wrong := refuse(contract.action, contract.noop):
        raise ValueError(f"noop: {wrong}")


def _positive(number: int, where: str) -> None:
    if number < 1:
        raise ValueError(f"{where} is {number}; it must be 1 or more")


def _convert(value: Any, kind: Any, where: str) -> Any:
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        raise ValueError(_told(str(error), value, kind, where)) from None


def _told(error: str, value: Any, kind: Any, where: str) -> str:
    """What msgspec says of a value, in words for who wrote it into a TOML file."""
    said, _, path = error.partition(" - at `$")
    path = path.strip(".`")
    structs = get_args(kind) or (kind,)
    prefix = f"{where}: " if where else ""
    if field := re.fullmatch("Object contains unknown field `(.+)`", said):
        names = [
            one.encode_name
            for struct in structs
            if struct.__struct_config__.tag in (None, value.get("type"))
            for one in msgspec.structs.fields(struct)
        ]
        return f"{prefix}there is no setting {unknown(field[1], names)}"
    if field := re.fullmatch("Object missing required field `(.+)`", said):
        return f"{prefix}{field[1]} is missing"
    if tag := re.fullmatch("Invalid value '(.+)'", said):
        return f"{prefix}there is no space {unknown(tag[1], [struct.__name__ for struct in structs])}"
    if expected := re.fullmatch(r"Expected `(.+?)`( of length \d+)?, got .*", said):
        for key, index in re.findall(r"([\w-]+)|\[(\d+)\]", path):
            value = value[key or int(index)]
        wanted = " or ".join(_KINDS.get(name, name) for name in expected[1].split(" | ") if name != "null")
        place = ".".join(filter(None, (where, path)))
        return f"{place or 'it'} must be {wanted}{expected[2] or ''}, and is {value!r}"
    return f"{prefix}{said} at {path}" if path else f"{prefix}{said}"
