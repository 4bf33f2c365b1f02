"""Resolve what names environments: files, folders, classes of installed packages, registered ids."""

from __future__ import annotations

import ast
import contextlib
import itertools
import os
import stat
import sys
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path

import click

from envcraft.errors import UsageError
from envcraft.model.classes import (
    Class,
    defined_classes,
    defined_names,
    defining_file,
    derivation,
    environment_line,
    no_class,
)
from envcraft.model.import_folders import import_folders, is_importable, project_folder
from envcraft.model.project import Place, with_project
from envcraft.model.target import Kind, Target, kind_of, nodes, parse, read_target
from envcraft.text import one_line, plural

#: The most modules that a message names.
_FEW = 5
#: The most files that are read for a message, or to find what derives from a class.
_READ = 100
#: How the names of files end that a project has beside its Python files.
_OTHER = {".cfg", ".csv", ".ini", ".json", ".md", ".rst", ".toml", ".txt", ".yaml", ".yml"}
#: How the names of pytest's files look.
_TESTS = ("conftest.py", "test_*.py", "*_test.py")
_SKIPPED_FOLDERS = {"__pycache__", "node_modules", "site-packages", "build", "dist"}


#: Receives the path of a file or folder that cannot be read, and the error.
Unreadable = Callable[[str, UsageError], None]


def refuse(path: str, error: UsageError) -> None:
    """Raise an error."""
    raise error


def resolve(
    path: str,
    env_class: str | None = None,
    environments_only: bool = False,
    unreadable: Unreadable = refuse,
) -> list[Target]:
    """Find what a TARGET names.

    Args:
        path: a file, a folder, ``package.module:Class`` or a registered id.
        env_class: the class to judge; files of a folder that do not define it are skipped.
        environments_only: skip a file that defines no environment; nothing may be left then.
        unreadable: receives each file and folder below a folder that cannot be read, with the error.

    Raises:
        UsageError: the target does not exist, cannot be read, or holds no environment.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        file, _, name = path.partition(".py:")
        if name and os.path.isfile(f"{file}.py"):
            words = f"to name a class of a file, write {file}.py --class {name.lstrip(':')}"
            raise UsageError(f"{path} does not exist; {words}") from None
        if (kind := kind_of(path)) is None:
            raise UsageError(_absent(path)) from None
        if env_class is not None:
            words = "names its class" if kind is Kind.MODULE else "has one class"
            text = f"--class {env_class} does not apply to {path}, which {words}; leave it out"
            raise UsageError(text, setting="class") from None
        return [_module(path) if kind is Kind.MODULE else _registered(path)]
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read: {getattr(error, 'strerror', None) or error}") from None
    if stat.S_ISREG(mode):
        if path.endswith(".ipynb"):
            raise UsageError(f"{path} is a notebook; envcraft.validate(CLASS) in a cell judges a class of it")
        if os.path.splitext(path)[1].lower() in _OTHER:
            raise UsageError(f"{path} is not a Python file; the name of an environment's file ends in .py")
        target = read_target(path, env_class)
        if not path.endswith(".py") and b"\0" in target.source:
            raise UsageError(f"{path} is not a Python file, but a binary one; name a file that ends in .py")
        if environments_only and (not _is_environment(target) or _is_base(target)):
            return []
        _require_class(target)
        return [with_project(target)]
    if not stat.S_ISDIR(mode):
        raise UsageError(f"{path} is neither a file nor a folder; save the environment in a file first")
    refuse_corpus(path)
    errors: dict[str, UsageError] = {}
    found = list(environments_below(path, env_class, errors.__setitem__))
    for place in errors:
        unreadable(place, errors[place])
    if not found and not errors and not environments_only:
        wanted = "subclass of gymnasium.Env" if env_class is None else f"subclass {env_class} of gymnasium.Env"
        raise UsageError(f"{path} holds no environment: no .py file in it defines a {wanted}")
    return found


def refuse_corpus(path: str) -> None:
    """Raise UsageError if a path is a corpus, in which the names of files say nothing to people."""
    from envcraft.corpus.store import is_corpus

    if is_corpus(Path(path)):
        raise UsageError(f"{path} is a corpus, not a folder of environments; judge it with `envcraft audit {path}`")


def _absent(path: str) -> str:
    """Say that a file does not exist, and what its name may mean."""
    if not path.strip():
        return "the target is empty; give a Python file, a folder, package.module:Class or an id like CartPole-v1"
    if os.path.isfile(f"{path}.py"):
        return f"{path} does not exist; did you mean {path}.py?"
    if "." in path and (file := _file_of(path)) is not None:
        classes = defined_classes(read_target(os.fspath(file)).source)
        return f"{path} is a module; name its class too: {path}:{classes[0] if len(classes) == 1 else 'CLASS'}"
    if "." in path and (words := _named_by_its_file(path)):
        return words
    if path.isidentifier() and (newest := _newest(path)) is not None:
        return f"{path} does not exist; did you mean {newest}?"
    module, _, name = path.rpartition(".")
    if module and name[:1].isupper() and all(part.isidentifier() for part in path.split(".")):
        return f"{path} does not exist; did you mean {module}:{name}?"
    return (
        f"{path} does not exist; give a Python file, a folder with some, package.module:Class or an id like CartPole-v1"
    )


def _file_of(module: str) -> Path | None:
    """The file of a module of the project or an installed one, which is not imported; None if there is none."""
    from importlib.machinery import PathFinder

    here = Path.cwd()
    for folder in (here, *import_folders(here), project_folder(here) or here):
        if (found := Place(folder, module).find(folder / module, module)) is not None:
            return found
    origin, path = None, list(sys.path)
    for part in module.split("."):
        spec = PathFinder.find_spec(part, path) if part else None
        if spec is None:
            return None
        origin, path = spec.origin, list(spec.submodule_search_locations or ())
    return Path(origin) if origin and origin.endswith(".py") else None


def _named_by_its_file(module: str, env_class: str = "") -> str:
    """Say which file has the name of a module, in a folder that imports do not start from; "" if there is none."""
    here = Path.cwd()
    for folder in (here / "src", *here.parents):
        if (found := Place(folder, module).find(folder / module, module)) is not None:
            option = f" --class {env_class}" if env_class else ""
            return f"{module} cannot be imported from this folder; name its file: {os.path.relpath(found)}{option}"
    return ""


def _newest(name: str) -> str | None:
    """The id of Gymnasium with the highest version of a name; None if there is none."""
    # Slow to import, and needed only for an error.
    from gymnasium import registry

    versions = [spec.version for spec in registry.values() if spec.namespace is None and spec.name == name]
    known = [version for version in versions if version is not None]
    return f"{name}-v{max(known)}" if known else None


def environments_below(folder: str, env_class: str | None = None, unreadable: Unreadable = refuse) -> Iterator[Target]:
    """Yield the environments in a folder by path; report on stderr at the end how many files are skipped.

    A class without ``reset`` or ``step``, or with a method for these that only raises NotImplementedError, is no
    environment if another of these environments derives from it.

    Args:
        folder: the folder.
        env_class: the class to judge; files that do not define it are skipped.
        unreadable: receives each file and folder that cannot be read and may hold an environment, with the error.

    Raises:
        UsageError: a file cannot be read, and `unreadable` raises its error.
    """
    passed, tests, others = [], [], []
    bases: set[Class] = set()
    held: list[tuple[str, Target, set[Class]]] = []
    for file in _python_files(folder, unreadable):
        try:
            target = read_target(file, env_class)
        except UsageError as error:
            unreadable(file, error)
            continue
        if not _is_environment(target):
            passed.append(file)
        elif _is_test(target):
            tests.append(file)
        elif _lacks_class(target):
            others.append(file)
        else:
            above, unfinished = derivation(target.source, Path(file))
            bases |= above
            # A possible base waits for the files that may derive from it, and those after it keep their order.
            if held or (unfinished and env_class is None):
                held.append((file, target, unfinished))
            else:
                yield with_project(target)
    for file, target, unfinished in held:
        if unfinished and unfinished <= bases and env_class is None:
            passed.append(file)
        else:
            yield with_project(target)
    for files, kind, without in (
        (passed, "file", " without an environment"),
        (tests, "test file", ""),
        (others, "file", f" without the class {env_class}"),
    ):
        say_skipped([os.path.relpath(file, folder) for file in files], kind, f"{without} in {one_line(folder)}")


def _is_base(target: Target) -> bool:
    """Whether each environment of a file is unfinished, and a file beside or below it derives from it."""
    file = Path(target.path)
    _, unfinished = derivation(target.source, file)
    bases: set[Class] = set()
    if unfinished:
        for other in itertools.islice(_python_files(os.fspath(file.parent), lambda *_: None), _READ):
            with contextlib.suppress(OSError):
                bases |= derivation(Path(other).read_bytes(), Path(other))[0]
    return bool(unfinished) and unfinished <= bases


def say_skipped(files: list[str], kind: str, words: str) -> None:
    """Report on stderr how many files are skipped, with the names of the first; nothing if there are none.

    Args:
        files: their paths.
        kind: what each is, such as ``file``.
        words: what follows the number, with a space before it.
    """
    named = ", ".join(one_line(file) for file in files[:3])
    if files:
        click.echo(f"skipped {plural(len(files), kind)}{words}: {named}{', …' if len(files) > 3 else ''}", err=True)


def _module(name: str) -> Target:
    """The class that ``package.module:Class`` names, from the working directory, what is installed, the folders that
    the project's tests import from, or the project's folder.
    """
    module, _, env_class = name.partition(":")
    root = here = Path.cwd()
    others: tuple[Path, ...] = ()
    if not _is_installed(module.partition(".")[0], here):
        others = (*import_folders(here), project_folder(here) or here)
    if Place(here, module).find(here / module, module) is None:
        root = next((each for each in others if Place(each, module).find(each / module, module) is not None), here)
    found = defining_file(root, module, env_class)
    if found is not None:
        file, defined = found
        return with_project(read_target(os.path.relpath(file), defined), root)
    if (own := Place(root, module).find(root / module, module)) is not None:
        _require_class(target := read_target(os.path.relpath(own), env_class))
        # The name is assigned or imported there, and a worker imports only what is installed.
        if not _is_installed(module.partition(".")[0], root):
            return with_project(target, root)
    else:
        for folder in (here, *others):
            _require_module(folder, module)
        words = _named_by_its_file(module, env_class)
        if words and not _is_installed(module.partition(".")[0], here):
            raise UsageError(words)
    return Target(name, kind=Kind.MODULE)


def _registered(name: str) -> Target:
    """The environment of an id. Raises UsageError if its package is a part of the project and not installed."""
    here, (module, _, wanted) = Path.cwd(), name.rpartition(":")
    if name.endswith(":"):
        raise UsageError(f"{name} names no environment; write its id after the colon, such as gymnasium:CartPole-v1")
    if "/" in module:
        raise UsageError(f"{name} does not exist; did you mean {name.replace('/', '.')}?")
    # Without a module, the namespace of the id is usually the name of the package.
    package = module.partition(".")[0] or wanted.rpartition("/")[0].lower()
    if package.isidentifier() and not is_importable(package, here):
        found = {
            file: ".".join(file.relative_to(folder).with_suffix("").parts).removesuffix(".__init__")
            for folder in (here, *import_folders(here))
            for file in (*sorted(folder.joinpath(package).rglob("*.py"))[:_READ], folder / f"{package}.py")
            if file.is_file()
        }
        entry = next(filter(None, (_entry_point(file, each, wanted) for file, each in found.items())), None)
        if entry or (module and found):
            words = f"{name} is an id of the package {package}, which is not installed but a part of the project"
            module = package if any(file.stem == package for file in found) else f"{package}.module"
            raise UsageError(f"{words}; name its class, {entry or f'such as {module}:Class'}")
    return Target(name, kind=Kind.ID)


def _entry_point(file: Path, module: str, wanted: str) -> str | None:
    """The class for which a file, which is a module, registers an id, as its text says; None if it does not say so."""
    try:
        calls = [node for node in nodes(parse(file.read_bytes())) if isinstance(node, ast.Call)]
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return None
    for call in calls:
        given = {key.arg: key.value for key in call.keywords} | dict(
            zip(("id", "entry_point"), call.args, strict=False)
        )
        match given.get("id"), given.get("entry_point"):
            case ast.Constant(value=name), ast.Constant(value=str(entry)) if name == wanted and ":" in entry:
                return entry
            case ast.Constant(value=name), ast.Name(id=entry) if name == wanted:
                return f"{module}:{entry}"
    return None


def _require_module(root: Path, module: str) -> None:
    """Raise UsageError if a name means a package below a folder that lacks the module."""
    package = module.partition(".")[0]
    if package == module or next(root.glob(f"{package}/*.py"), None) is None or _is_installed(package, root):
        return
    folder = root.joinpath(*module.split(".")[:-1])
    names = sorted(file.stem for file in folder.glob("*.py") if file.stem != "__init__")
    there = f"; {os.path.relpath(folder, root)} has {', '.join(names[:_FEW])}" if names else ""
    raise UsageError(f"the folder {package} has no module {module}{there}")


def _is_installed(package: str, folder: Path) -> bool:
    """Whether Python finds a package outside a project's folder, without importing it."""
    from importlib.machinery import PathFinder

    path = [each for each in sys.path if not _is_project_s(Path(each or ".").resolve(), folder.resolve())]
    return PathFinder.find_spec(package, path) is not None


def _is_project_s(path: Path, folder: Path) -> bool:
    """Whether Python imports a project's own modules from a path, and not what is installed in the project's folder."""
    return path.is_relative_to(folder) and not _SKIPPED_FOLDERS & set(path.relative_to(folder).parts)


def _is_environment(target: Target) -> bool:
    return environment_line(target.source, Path(target.path)) is not None


def _is_test(target: Target) -> bool:
    """Whether a file is one of pytest's, whose environments stand in for others: its name says so, and its code."""
    name = os.path.basename(target.path)
    if not any(fnmatchcase(name, pattern) for pattern in _TESTS):
        return False
    try:
        body = parse(target.source).body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    names = [node.name.lower() for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    return name == _TESTS[0] or any(each.startswith("test") for each in names)


def _require_class(target: Target) -> None:
    """Raise UsageError if a file cannot define the class that ``--class`` names."""
    if _lacks_class(target):
        classes = defined_classes(target.source)
        there = f"; its classes are {', '.join(classes)}" if classes else "; it defines no class"
        raise UsageError(f"{target.path} defines no class {target.env_class}{there}", setting="class")
    if target.env_class is not None and (kind := no_class(target.source, target.env_class)):
        words = f"{target.env_class} of {target.path} is {kind}; name a class that derives from gymnasium.Env"
        raise UsageError(words, setting="class")


def _lacks_class(target: Target) -> bool:
    """Whether a file cannot define the class that ``--class`` names."""
    names = None if target.env_class is None else defined_names(target.source)
    return names is not None and target.env_class not in names


def _python_files(folder: str, unreadable: Unreadable) -> Iterator[str]:
    from envcraft.corpus.store import is_corpus

    def report(error: OSError) -> None:
        place = os.fspath(error.filename)
        unreadable(place, UsageError(f"{place} cannot be read: {error.strerror}"))

    for parent, folders, files in os.walk(folder, onerror=report):
        folders[:] = sorted(
            name
            for name in folders
            # A corpus keeps copies of sources, which are not the folder's own environments.
            if not name.startswith(".") and name not in _SKIPPED_FOLDERS and not is_corpus(Path(parent, name))
        )
        for name in sorted(files):
            path = os.path.join(parent, name)
            # Links count: the snapshots in a Hugging Face cache are links.
            if name.endswith(".py") and os.path.isfile(path):
                yield path
