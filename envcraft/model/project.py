"""The files of a project as imports find them, and which of them a file needs. No code runs here.

A file is imported from two folders: its own, as a script is, and the folder above the outermost package around it. What
neither has may be in the folders that the tests of its project import from.
"""

from __future__ import annotations

import ast
import contextlib
import itertools
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from envcraft.model.import_folders import import_folders, is_importable, project_folder
from envcraft.model.target import MAX_SOURCE, Kind, Project, Target, nodes, parse

#: The most bytes of a project that a worker gets, and the most files of a folder.
_MAX_BYTES, _MOST_FILES = 4 * 1024**2, 1_000
#: The longest string that may name a file.
_LONGEST = 200
#: Stands for the file of a target that is none.
_NO_FILE = "-"
#: What the parser raises for what is not Python.
UNREADABLE = (SyntaxError, ValueError, RecursionError, MemoryError)


class Place(msgspec.Struct, frozen=True):
    """Where a file is in its project.

    Attributes:
        root: the folder that its imports start from.
        module: the file's dotted name below `root`.
        others: more folders that imports start from, for what the file's own and `root` do not have.
    """

    root: Path
    module: str
    others: tuple[Path, ...] = ()

    @classmethod
    def of(cls, file: Path) -> Place:
        """Find the folder above the outermost package around a file."""
        file = Path(os.path.abspath(file))
        root = file.parent
        while (root / "__init__.py").is_file() and root.name.isidentifier() and root.parent != root:
            root = root.parent
        others = tuple(each for each in import_folders(file.parent) if each != root)
        return cls(root, _dotted(file, root), others)

    @property
    def roots(self) -> tuple[Path, ...]:
        """All folders that imports start from, besides the file's own."""
        return (self.root, *self.others)

    def find(self, file: Path, module: str, level: int = 0) -> Path | None:
        """Return the project's file that an import in `file` names.

        Args:
            file: the file with the import statement.
            module: the dotted name of the module; "" for ``from . import name``.
            level: the number of dots before it.

        Returns:
            A module, or the ``__init__.py`` of a package; None if the project has no such module.
        """
        folder = Path(os.path.abspath(file)).parent
        if level:
            for _ in range(level - 1):
                folder = folder.parent
            starts = [folder] if any(map(folder.is_relative_to, self.roots)) else []
        else:
            starts = list(dict.fromkeys([folder, *self.roots]))
        parts = module.split(".") if module else []
        for start in starts:
            path = start.joinpath(*parts)
            for found in (path.with_suffix(".py") if parts else path / "__init__.py", path / "__init__.py"):
                if found.is_file():
                    return found
        return None


def with_project(target: Target, root: Path | None = None) -> Target:
    """Give a file the files of its project that it needs.

    These are the modules of its wrappers and those that it imports, directly or not, the packages around them, and the
    files and folders that a string in one of these names. Hidden files, links that leave the project, folders with more
    than `_MOST_FILES` and what exceeds `_MAX_BYTES` are left out.

    Args:
        target: a file.
        root: the folder that imports start from, if the user named a module below it; else it is searched for.

    Returns:
        The target; unchanged if it needs no other file.
    """
    if len(target.source) > MAX_SOURCE:
        return target
    file = Path(os.path.abspath(target.path))
    place = _place(file, target.source) if root is None else Place(root, _dotted(file, root))
    here = _working_folder(target.wrappers)
    if here is not None and any(place.find(file, each.partition(":")[0]) is None for each in target.wrappers):
        place = Place(place.root, place.module, (*place.others, here))
    # The folder above one that only an import shows to be a package is not the project's.
    folders = [place.root] if root is not None or place == Place.of(file) else []
    closure = _Closure(file, place, folders)
    closure.follow(file, target.source)
    for wrapper in target.wrappers:
        closure.add_module(wrapper.partition(":")[0])
    if closure.files:
        # Importing a module runs the packages around it.
        closure.add_packages(file)
    for found, source in list(closure.sources.items()):
        closure.add_data(found, source)
    project = closure.project(named=root is not None)
    return target if project is None else msgspec.structs.replace(target, project=project)


def configured(target: Target, kwargs: dict[str, Any], wrappers: Sequence[str]) -> Target:
    """Give a target arguments and wrappers, and the files of its project that the wrappers need.

    Args:
        target: a target, with the files of its project.
        kwargs: what the constructor is given.
        wrappers: ``module:callable`` of each wrapper, the innermost first.
    """
    target = msgspec.structs.replace(target, kwargs=kwargs, wrappers=tuple(wrappers))
    if not wrappers:
        return target
    if target.kind is not Kind.SOURCE:
        return msgspec.structs.replace(target, project=_of_wrappers(wrappers))
    known = target.project
    return with_project(target, Path(known.root) if known is not None and known.named else None)


def module_name(file: Path) -> str:
    """The name by which ``--wrap`` finds a file, in the working directory or a folder that imports start from."""
    file, here = Path(os.path.abspath(file)), Path.cwd()
    place = Place.of(file)
    outside = place.root in (here, *import_folders(here)) or not file.is_relative_to(here)
    return place.module if outside else _dotted(file, here)


def _of_wrappers(wrappers: Sequence[str]) -> Project | None:
    """The files of wrappers in the working directory, for a target that is no file."""
    here = _working_folder(wrappers)
    if here is None:
        return None
    closure = _Closure(here / _NO_FILE, Place(here, "", import_folders(here)), [here])
    for wrapper in wrappers:
        closure.add_module(wrapper.partition(":")[0])
    for found, source in list(closure.sources.items()):
        closure.add_data(found, source)
    return closure.project(named=False)


def _working_folder(wrappers: Sequence[str]) -> Path | None:
    """The working directory if it, or a folder that the project's tests import from, has the module of a wrapper that
    is not installed.
    """
    here = Path.cwd()
    place = Place(here, "", import_folders(here))
    modules = [wrapper.partition(":")[0] for wrapper in wrappers]
    own = (each for each in modules if place.find(here / _NO_FILE, each) is not None)
    return here if any(not is_importable(each.partition(".")[0], here) for each in own) else None


def _dotted(file: Path, root: Path) -> str:
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _place(file: Path, source: bytes) -> Place:
    """The place of a file. A relative import shows that folders without ``__init__.py`` are packages, too."""
    place = Place.of(file)
    levels = [0]
    with contextlib.suppress(*UNREADABLE):
        levels += [node.level for node in nodes(parse(source)) if isinstance(node, ast.ImportFrom)]
    root = place.root
    for _ in range(max(levels) - len(file.relative_to(root).parts) + 1):
        if not root.name.isidentifier():
            return place
        root = root.parent
    return Place(root, _dotted(file, root), place.others)


class _Closure:
    """The files of a project that a file needs.

    Args:
        file: the file.
        place: where it is.
        folders: where strings name files, besides the folder of their module.

    Attributes:
        files: their bytes, without the file itself.
        sources: the Python files among them, and the file itself.
        modules: the names of the project's modules, as import statements write their first part.
    """

    def __init__(self, file: Path, place: Place, folders: list[Path]) -> None:
        self.files: dict[Path, bytes] = {}
        self.sources: dict[Path, bytes] = {}
        self.modules: set[str] = set()
        self._file = file
        self._place = place
        self._folders = folders
        self._left = _MAX_BYTES

    def follow(self, file: Path, source: bytes) -> None:
        """Add the modules that a source imports, and those that these import."""
        pending = [(file, source)]
        while pending:
            file, source = pending.pop()
            self.sources[file] = source
            try:
                tree = parse(source)
            except UNREADABLE:
                continue
            for name, module, level in _imports(tree):
                found = self._place.find(file, module, level)
                if found is None:
                    continue
                self.modules.add(name)
                for each in (found, *self._packages(found)):
                    if each not in self.sources and (data := self._add(each)) is not None:
                        pending.append((each, data))

    def add_module(self, module: str) -> None:
        """Add a module that is not imported but named, and what it imports, if the project has it."""
        found = self._place.find(self._file, module)
        if found is None:
            return
        self.modules.add(module.partition(".")[0])
        for each in (found, *self._packages(found)):
            if each not in self.sources and (data := self._add(each)) is not None:
                self.follow(each, data)

    def add_packages(self, file: Path) -> None:
        """Add the packages around a file, and what they import."""
        for each in self._packages(file):
            if each not in self.sources and (data := self._add(each)) is not None:
                self.follow(each, data)

    def add_data(self, file: Path, source: bytes) -> None:
        """Add the files that are not Python and that a string of a source names."""
        try:
            tree = parse(source)
        except UNREADABLE:
            return
        texts = {node.value for node in nodes(tree) if isinstance(node, ast.Constant) and type(node.value) is str}
        starts = dict.fromkeys([file.parent, *self._folders, *(self._above(file) if _climbs(tree, texts) else ())])
        # importlib.resources names a folder as a package.
        texts |= {text.replace(".", "/") for text in texts if "." in text and text.replace(".", "").isidentifier()}
        for text in sorted(texts):
            # A text such as "/../data" is appended to a folder; its rest names the same from a folder above.
            parts = list(itertools.dropwhile(("/", "..").__contains__, Path(text).parts))
            if not parts or len(text) > _LONGEST or "\0" in text or any(part[0] in "./" for part in parts):
                continue
            for start in starts:
                path = start.joinpath(*parts)
                with contextlib.suppress(OSError):
                    below = list(itertools.islice(path.rglob("*"), _MOST_FILES + 1)) if path.is_dir() else [path]
                    for each in sorted(below) if len(below) <= _MOST_FILES else ():
                        if each.suffix not in (".py", ".pyc") and not _hidden(each.relative_to(start)):
                            self._add(each)

    def project(self, named: bool) -> Project | None:
        """The files as a project; None if there are none."""
        if not self.files:
            return None
        place, others = self._place, self._place.others
        used = [place.root, *(each for each in others if any(path.is_relative_to(each) for path in self.files))]
        top = Path(os.path.commonpath([*used, *(path.parent for path in self.files)]))
        files = {path.relative_to(top).as_posix(): data for path, data in self.files.items()}
        imports = tuple(each.relative_to(top).as_posix() for each in used) if used != [top] else ()
        own = "" if self._file.name == _NO_FILE else self._file.relative_to(top).as_posix()
        return Project(str(top), place.module, own, files, frozenset(self.modules), named, imports)

    def _above(self, file: Path) -> list[Path]:
        """The folders between that of a file and that of its project."""
        project = project_folder(file.parent)
        return [each for each in file.parent.parents if project is not None and each.is_relative_to(project)]

    def _packages(self, file: Path) -> list[Path]:
        roots = self._place.roots
        folders = [folder for folder in file.parents if any(root in folder.parents for root in roots)]
        inits = [folder / "__init__.py" for folder in folders if folder not in roots]
        return [init for init in inits if init != file and init.is_file()]

    def _add(self, file: Path) -> bytes | None:
        """Read a file of the project; None if it is the target, cannot be read, or is too large."""
        if file == self._file or file in self.files or not file.is_file():
            return None
        project = project_folder(self._file.parent)
        allowed = self._place.roots if project is None else (*self._place.roots, project)
        roots = [root.resolve() for root in allowed if file.is_relative_to(root)]
        if not any(map(file.resolve().is_relative_to, roots)) or file.stat().st_size > self._left:
            return None
        try:
            data = file.read_bytes()
        except OSError:
            return None
        self._left -= len(data)
        self.files[file] = data
        return data


def _climbs(tree: ast.Module, texts: set[str]) -> bool:
    """Whether a module names a folder above its own: by ``parent`` twice, ``parents``, ``dirname`` twice or ``..``."""
    names = [node.attr for node in nodes(tree) if isinstance(node, ast.Attribute)]
    names += [node.id for node in nodes(tree) if isinstance(node, ast.Name)]
    return (
        max(names.count("parent"), names.count("dirname")) > 1
        or not {"parents", "pardir"}.isdisjoint(names)
        or any(".." in Path(text).parts for text in texts if len(text) <= _LONGEST)
    )


def _hidden(path: Path) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _imports(tree: ast.Module) -> Iterator[tuple[str, str, int]]:
    """What the import statements of a module may import.

    Yields:
        The first part of the name, or all of a relative one with its dots; the dotted name; and the number of dots.
    """
    for node in nodes(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                parts = alias.name.split(".")
                yield from ((parts[0], ".".join(parts[:end]), 0) for end in range(1, len(parts) + 1))
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            parts = base.split(".")
            name = "." * node.level + base if node.level else parts[0]
            # The package around a module that does not exist is the project's all the same.
            yield from ((name, ".".join(parts[:end]), 0) for end in range(1, 0 if node.level else len(parts)))
            if base or node.level:
                yield name, base, node.level
            for alias in node.names:
                yield name, f"{base}.{alias.name}".lstrip("."), node.level
