"""The code that a verdict depends on: the modules that judging imports, directly or not, read from their source.

The import graph decides, not the folder: a change in a command leaves stored verdicts valid, a change in a module that
the engine, a check or the worker imports does not, wherever that module lies.
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

#: Both sides of the trust boundary import it, the worker by way of the driver.
_PROTOCOL = "envcraft_protocol"
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ ]+(\.*)([\w.]*)[ ]+import[ ]+(\([^)]*\)|[^\n]*)|import[ ]+([^\n]*))", re.MULTILINE
)


def code_digest(classes: Iterable[type], packages: Iterable[str] = ()) -> bytes:
    """Digest the code that judges.

    Args:
        classes: the classes of the checks and the driver.
        packages: names of packages that count with all of their modules, such as the worker, which a driver starts by
            name.

    Returns:
        A SHA-256 of the names and contents of the engine's modules, of what the classes' modules import, and of the
        packages. A class of another project counts with its whole package, which may load modules in ways that no
        import statement shows. The digest does not depend on where the files lie.
    """
    names = {kind.__module__ for kind in classes}
    own = {name for name in names if name.startswith("envcraft")}
    return _digest(frozenset({"envcraft.judging.engine"} | own), frozenset({_PROTOCOL, *packages} | (names - own)))


@cache
def _digest(roots: frozenset[str], whole: frozenset[str]) -> bytes:
    modules: dict[str, Path] = {}
    for top in {root.partition(".")[0] for root in roots}:
        modules |= modules_of(top)
    files = {name: modules[name] for name in reachable(roots, modules)}
    for name in whole:
        files |= modules_of(name)
    digest = hashlib.sha256()
    for name, path in sorted(files.items()):
        digest.update(hashlib.sha256(name.encode() + b"\0" + path.read_bytes()).digest())
    return digest.digest()


def modules_of(name: str) -> dict[str, Path]:
    """Find the source files of a package, or of a module that is in none.

    Args:
        name: a package of EnvCraft, whose modules are given; or a module of another project, whose top-level package
            is.

    Returns:
        The files by module name. A module without source, such as one that a test defines, has none.
    """
    top = name.partition(".")[0]
    package = sys.modules.get(top)
    folders = list(getattr(package, "__path__", ()))
    # Found, not imported: importing may be slow.
    if package is None and (spec := importlib.util.find_spec(top)) is not None:
        folders = list(spec.submodule_search_locations or ())
    # A namespace package has no file, and spreads over folders of other projects.
    if folders and (package is None or getattr(package, "__file__", None)):
        root = Path(folders[0])
        found = {".".join((top, *_parts(path.relative_to(root)))): path for path in sorted(root.rglob("*.py"))}
        below = name if top.startswith("envcraft") else top
        return {module: path for module, path in found.items() if f"{module}.".startswith(f"{below}.")}
    file = getattr(sys.modules.get(name), "__file__", None)
    return {name: Path(file)} if file else {}


def reachable(roots: Iterable[str], modules: Mapping[str, Path]) -> set[str]:
    """Follow imports from `roots` through `modules`; lazy and type-checking imports count, `roots` are included.

    Args:
        roots: module names; unknown ones are left out.
        modules: the source files that may be followed, by module name.

    Returns:
        The names of the modules that can be reached.
    """
    found: set[str] = set()
    pending = [root for root in roots if root in modules]
    while pending:
        name = pending.pop()
        if name not in found:
            found.add(name)
            pending += imports(name, modules)
    return found


def imports(name: str, modules: Mapping[str, Path]) -> Iterator[str]:
    """Read which of `modules` a module imports, in the order of its statements.

    Parsing would take half a second for all modules. An import statement in a string counts too: verdicts become stale
    once too often, never once too seldom.
    """
    package = name if modules[name].name == "__init__.py" else name.rpartition(".")[0]
    for dots, origin, names, plain in _IMPORT.findall(modules[name].read_text("utf-8")):
        above = package.split(".")[: len(package.split(".")) - len(dots) + 1] if dots else []
        base = ".".join([*above, *([origin] if origin else [])])
        for item in (names or plain).strip("()").split(","):
            word = item.split("#")[0].split(" as ")[0].strip()
            target = word if plain else f"{base}.{word}"
            if target in modules:
                yield target
            elif base in modules:
                yield base


def _parts(path: Path) -> tuple[str, ...]:
    parts = path.with_suffix("").parts
    return parts[:-1] if parts[-1] == "__init__" else parts
