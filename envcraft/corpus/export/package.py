"""A Python package of a corpus: it registers its environments with Gymnasium, and needs no EnvCraft to run them."""

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
#: Of ``envcraft_protocol``, what makes an environment of a class; each package has its own copy.
_RUNTIME = ("__init__.py", "adapters.py", "classes.py")
_ALWAYS = ("gymnasium>=1.0", "numpy>=1.26")
#: Distributions of what the built-in contracts let environments import, but for those that are always required.
_DISTRIBUTIONS = {"gymnasium": None, "numpy": None, "pygame": "pygame-ce>=2.5", "scipy": "scipy>=1.11"}
#: So many ids are listed in the README.
_LISTED = 20


class PackageExporter(Exporter):
    name = "package"
    summary = "a Python package that pip installs and that registers the environments with Gymnasium"

    def export(self, order: Order) -> list[str]:
        if order.licence is not None:
            raise UsageError("--licence is for the card of --to hf; a package's goes into its pyproject.toml")
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
            # A bare word would be the name of something in the registry.
            f"{plural(len(entries), 'environment')} in {order.output}: "
            f"`pip install {shlex.quote(str(order.output.absolute()))}`, then in Python",
            f'  gymnasium.make("{package}:{first}")',
        ]
        if others := sorted(name for name in modules - {*sys.stdlib_module_names, *_DISTRIBUTIONS}):
            # Sources are not asked what to install: a name that nobody has taken yet may be taken for them.
            lines.append(f"sources import also {one_line(', '.join(others))}, which the package does not require")
        return lines


def package_name(order: Order) -> str:
    """What the package is called: as the user said, else after the corpus. Raises UsageError."""
    name = order.name or re.sub(r"\W+", "_", order.title.lower(), flags=re.ASCII).strip("_")
    taken = {*sys.stdlib_module_names, "envcraft", "gymnasium", "numpy"}
    if not (name.isidentifier() and name.isascii()) or keyword.iskeyword(name) or name in taken or name[0] == "_":
        raise UsageError(f"{name!r} is no name for a package; give another with --name, such as --name my_games")
    return name


class _Names:
    """Module names for environments, each once, also where a file system knows no capitals."""

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
    """What the package knows of an environment: where it is, and what was judged of it. Raises UsageError."""
    from envcraft.contracts.lookup import contract_named
    from envcraft.corpus.ids import identifier
    from envcraft.corpus.store import decode
    from envcraft.judging.settings import contract_digest

    judged = decode(environment.report).env_class if environment.report else None
    contract = contract_named(environment.contract or "arcade")
    if environment.contract_sha256 not in (None, contract_digest(contract)):
        raise UsageError(
            f"{one_line(environment.name)} was judged under another contract {contract.name} than there is now: "
            "`envcraft audit` judges it under this one"
        )
    return {
        "id": identifier(environment.name, package),
        "name": environment.name,
        "module": module,
        "class": environment.env_class or judged,
        "sha256": environment.source,
        "adapter": contract.adapter,
        "verdict": environment.verdict,
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
    """What the package requires of the modules that its sources import."""
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

    told = msgspec.json.encode({"schema": 1, "envcraft": __version__, "environments": entries})
    (folder / package / "environments.json").write_bytes(msgspec.json.format(told, indent=1) + b"\n")
    passed = sum(entry["verdict"] == "pass" for entry in entries)
    words = {
        "PACKAGE": package,
        "COUNT": f"{len(entries):,}",
        "PASSED": f"{passed:,}",
        "VERSION": __version__,
        "FIRST": entries[0]["id"],
        "REQUIREMENTS": ", ".join(f'"{requirement}"' for requirement in requirements),
        "IDS": "\n".join(f"- `{entry['id']}`" for entry in entries[:_LISTED])
        + (f"\n- and {len(entries) - _LISTED:,} more" if len(entries) > _LISTED else ""),
    }
    for name in ("pyproject.toml", "README.md"):
        text = (_SKELETON / f"{name}.txt").read_text("utf-8")
        (folder / name).write_text(re.sub(r"@([A-Z]+)@", lambda found: words[found[1]], text), "utf-8")


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    return [PackageExporter()]
