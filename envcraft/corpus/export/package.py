"""The export format ``package``: a Python package that registers its environments and runs without EnvCraft."""

from __future__ import annotations

import importlib.util
import keyword
import re
import shlex
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from envcraft.corpus.export.exporter import Exported, Exporter, Order, fresh_folder
from envcraft.errors import UsageError
from envcraft.plugins import hookimpl
from envcraft.text import one_line, plural

_SKELETON = Path(__file__).parent / "skeleton"
#: The modules of ``envcraft_protocol`` that construct an environment. Each package has its own copy.
_RUNTIME = ("__init__.py", "adapters.py", "classes.py")
_ALWAYS = ("gymnasium>=1.0", "numpy>=1.26", "pillow>=10")
#: Requirements by the modules that built-in contracts allow; None for those that are always required.
_DISTRIBUTIONS = {"gymnasium": None, "numpy": None, "pygame": "pygame-ce>=2.5", "scipy": "scipy>=1.11"}
#: Maximum number of ids in the README.
_LISTED = 20


class PackageExporter(Exporter):
    """Writes a package that pip can install."""

    name = "package"
    summary = "a Python package that pip installs and that registers the environments with Gymnasium"

    def export(self, order: Order) -> list[str]:
        if order.licence is not None:
            raise UsageError("--licence applies to --to hf; state a package's licence in its pyproject.toml")
        package = package_name(order)
        from envcraft.model.target import imported

        modules: set[str] = set()
        entries: list[dict[str, Any]] = []
        with fresh_folder(order.output) as folder:
            sources = folder / package / "sources"
            sources.mkdir(parents=True)
            (sources / "__init__.py").write_text('"""The environments, each file as it was validated."""\n', "utf-8")
            names = _Names()
            for environment in order.environments():
                module = names.module(environment)
                source = order.store.source(environment.source)
                (sources / f"{module}.py").write_bytes(source)
                modules.update(imported(source))
                entries.append(_entry(environment, package, module))
            if not entries:
                raise order.nothing()
            _write_code(folder / package)
            _write_texts(folder, package, entries, _requirements(modules))
        first = entries[0]["id"]
        lines = [
            # An absolute path, because pip looks up a bare word in the package index.
            f"{plural(len(entries), 'environment')} in {order.output}: "
            f"`pip install {shlex.quote(str(order.output.absolute()))}`, then in Python",
            f'  gymnasium.make("{package}:{first}")',
        ]
        if others := sorted(name for name in modules - {*sys.stdlib_module_names, *_DISTRIBUTIONS}):
            # Not added to the requirements: an untrusted source could name a malicious distribution.
            lines.append(f"the sources also import {one_line(', '.join(others))}, which the package does not require")
        return lines


def package_name(order: Order) -> str:
    """Return the package's name: the user's choice, or one that is derived from the corpus.

    Raises:
        UsageError: it is not a valid name for a package.
    """
    name = order.name or re.sub(r"\W+", "_", order.title.lower(), flags=re.ASCII).strip("_")
    taken = {*sys.stdlib_module_names, "envcraft", "gymnasium", "numpy"}
    if not (name.isidentifier() and name.isascii()) or keyword.iskeyword(name) or name in taken or name[0] == "_":
        raise UsageError(f"{name!r} is not a valid package name; choose one with --name, such as --name my_games")
    return name


class _Names:
    """Unique module names for environments, also on a file system that ignores case."""

    def __init__(self) -> None:
        self._taken = {"__init__"}

    def module(self, environment: Exported) -> str:
        stem = re.sub(r"\W", "_", environment.name.removesuffix(".py"), flags=re.ASCII)
        stem = f"env_{stem}" if not stem.isidentifier() or keyword.iskeyword(stem) else stem
        number = 0
        name = stem
        while name.lower() in self._taken:
            number += 1
            name = f"{stem}_{environment.source[:8]}" + (f"_{number}" if number > 1 else "")
        self._taken.add(name.lower())
        return name


def _entry(environment: Exported, package: str, module: str) -> dict[str, Any]:
    """Build an environment's record of ``environments.json``. Raises UsageError if its contract has changed."""
    from envcraft.contracts.lookup import contract_named
    from envcraft.corpus.ids import identifier
    from envcraft.corpus.store import decode
    from envcraft.judging.settings import contract_digest

    judged = decode(environment.report).env_class if environment.report else None
    contract = contract_named(environment.contract or "arcade")
    if environment.contract_sha256 not in (None, contract_digest(contract)):
        raise UsageError(
            f"{one_line(environment.name)} was judged under another version of the contract {contract.name}: "
            "run `envcraft audit` to judge it under the present one"
        )
    return {
        "id": identifier(environment.name, package),
        "name": environment.name,
        "module": module,
        "class": environment.env_class or judged,
        "sha256": environment.source,
        "adapter": contract.adapter,
        "verdict": environment.verdict,
        "undecided": environment.undecided,
        "contract": environment.contract,
        "contract_sha256": environment.contract_sha256,
        "rules": environment.rules,
        "budget": environment.budget,
        "seed": environment.seed,
        "sandbox": environment.driver,
        "image": environment.image,
        "origin": environment.public,
    }


def _requirements(modules: Iterable[str]) -> list[str]:
    """Return the package's requirements, given the modules that its sources import."""
    known = {_DISTRIBUTIONS.get(name) for name in modules}
    return [*_ALWAYS, *sorted(filter(None, known))]


def _write_code(folder: Path) -> None:
    for name in ("__init__.py", "_making.py"):
        (folder / name).write_bytes((_SKELETON / name).read_bytes())
    spec = importlib.util.find_spec("envcraft_protocol")
    assert spec is not None
    assert spec.origin is not None
    (folder / "_runtime").mkdir()
    for name in _RUNTIME:
        (folder / "_runtime" / name).write_bytes(Path(spec.origin).with_name(name).read_bytes())


def _write_texts(folder: Path, package: str, entries: list[dict[str, Any]], requirements: list[str]) -> None:
    import msgspec

    from envcraft.version import __version__

    data = msgspec.json.encode({"schema": 1, "envcraft": __version__, "environments": entries})
    (folder / package / "environments.json").write_bytes(msgspec.json.format(data, indent=1) + b"\n")
    passed = sum(entry["verdict"] == "pass" and not entry["undecided"] for entry in entries)
    undecided = sum(bool(entry["undecided"]) for entry in entries)
    words = {
        "PACKAGE": package,
        "COUNT": f"{len(entries):,}",
        "PASSED": f"{passed:,}",
        "FAILED": f"{sum(entry['verdict'] == 'fail' for entry in entries):,}",
        "UNDECIDED": f"{undecided:,}",
        "VERSION": __version__,
        "FIRST": entries[0]["id"],
        "REQUIREMENTS": ", ".join(f'"{requirement}"' for requirement in requirements),
        "IDS": "\n".join(f"- `{entry['id']}`" for entry in entries[:_LISTED])
        + (f"\n- and {len(entries) - _LISTED:,} more" if len(entries) > _LISTED else ""),
    }
    for name in ("pyproject.toml", "README.md"):
        text = (_SKELETON / f"{name}.txt").read_text("utf-8")
        (folder / name).write_text(re.sub(r"@([A-Z]+)@", lambda match: words[match[1]], text), "utf-8")


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    return [PackageExporter()]
