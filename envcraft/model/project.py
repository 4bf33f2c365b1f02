"""The files of a project as imports find them: which a file needs, and which define environments. No code runs here.

A file is imported from two folders: its own, as a script is, and the folder above the outermost package around it.
"""

from __future__ import annotations

import ast
import contextlib
import itertools
import symtable
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec

from envcraft.model.target import MAX_SOURCE, Kind, Project, Target, nodes, parse

#: Maximum number of classes and modules that a base is followed through.
_DEEPEST = 20
#: The most bytes of a project that a worker gets, and the most files of a folder.
_MAX_BYTES, _MOST_FILES = 4 * 1024**2, 1_000
#: The longest string that may name a file.
_LONGEST = 200
#: The packages that define the base class of environments.
_GYMNASIUM = frozenset({"gymnasium", "gym"})
#: Bases of installed packages that are for many environments or agents at once, and do not derive from that class.
_OTHER_ENVS = frozenset({"AECEnv", "ParallelEnv", "VecEnv", "VectorEnv"})
#: What the parser raises for what is not Python.
_UNREADABLE = (SyntaxError, ValueError, RecursionError, MemoryError)


class Place(msgspec.Struct, frozen=True):
    """Where a file is in its project.

    Attributes:
        root: the folder that its imports start from.
        module: the file's dotted name below `root`.
    """

    root: Path
    module: str

    @classmethod
    def of(cls, file: Path) -> Place:
        """Find the folder above the outermost package around a file."""
        file = file.absolute()
        root = file.parent
        while (root / "__init__.py").is_file() and root.name.isidentifier() and root.parent != root:
            root = root.parent
        parts = file.relative_to(root).with_suffix("").parts
        return cls(root, ".".join(parts[:-1] if parts[-1] == "__init__" else parts))

    def find(self, file: Path, module: str, level: int = 0) -> Path | None:
        """Return the project's file that an import in `file` names.

        Args:
            file: the file with the import statement.
            module: the dotted name of the module; "" for ``from . import name``.
            level: the number of dots before it.

        Returns:
            A module, or the ``__init__.py`` of a package; None if the project has no such module.
        """
        folder = file.absolute().parent
        if level:
            for _ in range(level - 1):
                folder = folder.parent
            starts = [folder] if folder.is_relative_to(self.root) else []
        else:
            starts = list(dict.fromkeys([folder, self.root]))
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
    file = Path(target.path).absolute()
    place = _place(file, target.source) if root is None else Place(root, _dotted(file, root))
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
    if not closure.files:
        return target
    own = file.relative_to(place.root).as_posix()
    project = Project(
        str(place.root), place.module, own, closure.files, frozenset(closure.modules), named=root is not None
    )
    return msgspec.structs.replace(target, project=project)


def configured(target: Target, kwargs: dict[str, Any], wrappers: Sequence[str]) -> Target:
    """Give a target arguments and wrappers, and the files of its project that the wrappers need.

    Args:
        target: a target, with the files of its project.
        kwargs: what the constructor is given.
        wrappers: ``module:callable`` of each wrapper, the innermost first.
    """
    target = msgspec.structs.replace(target, kwargs=kwargs, wrappers=tuple(wrappers))
    if not wrappers or target.kind is not Kind.SOURCE:
        return target
    known = target.project
    return with_project(target, Path(known.root) if known is not None and known.named else None)


def _dotted(file: Path, root: Path) -> str:
    parts = file.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _place(file: Path, source: bytes) -> Place:
    """The place of a file. A relative import shows that folders without ``__init__.py`` are packages, too."""
    place = Place.of(file)
    levels = [0]
    with contextlib.suppress(*_UNREADABLE):
        levels += [node.level for node in nodes(parse(source)) if isinstance(node, ast.ImportFrom)]
    root = place.root
    for _ in range(max(levels) - len(file.relative_to(root).parts) + 1):
        if not root.name.isidentifier():
            return place
        root = root.parent
    return Place(root, _dotted(file, root))


class _Closure:
    """The files of a project that a file needs.

    Args:
        file: the file.
        place: where it is.
        folders: where strings name files, besides the folder of their module.

    Attributes:
        files: their bytes by path below the root, without the file itself.
        sources: the Python files among them, and the file itself.
        modules: the names of the project's modules, as import statements write their first part.
    """

    def __init__(self, file: Path, place: Place, folders: list[Path]) -> None:
        self.files: dict[str, bytes] = {}
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
            except _UNREADABLE:
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
        except _UNREADABLE:
            return
        texts = {node.value for node in nodes(tree) if isinstance(node, ast.Constant) and type(node.value) is str}
        for text in sorted(texts):
            parts = Path(text).parts
            if not parts or len(text) > _LONGEST or "\0" in text or any(part[0] in "./" for part in parts):
                continue
            for start in dict.fromkeys([file.parent, *self._folders]):
                path = start / text
                with contextlib.suppress(OSError):
                    below = list(itertools.islice(path.rglob("*"), _MOST_FILES + 1)) if path.is_dir() else [path]
                    for each in sorted(below) if len(below) <= _MOST_FILES else ():
                        if each.suffix not in (".py", ".pyc") and not _hidden(each.relative_to(start)):
                            self._add(each)

    def _packages(self, file: Path) -> list[Path]:
        folders = [folder for folder in file.parents if folder.is_relative_to(self._place.root)]
        inits = [folder / "__init__.py" for folder in folders if folder != self._place.root]
        return [init for init in inits if init != file and init.is_file()]

    def _add(self, file: Path) -> bytes | None:
        """Read a file of the project; None if it is the target, cannot be read, or is too large."""
        path = file.relative_to(self._place.root).as_posix()
        if file == self._file or path in self.files or not file.is_file():
            return None
        if not file.resolve().is_relative_to(self._place.root.resolve()) or file.stat().st_size > self._left:
            return None
        try:
            data = file.read_bytes()
        except OSError:
            return None
        self._left -= len(data)
        self.files[path] = data
        return data


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
            name = "." * node.level + base if node.level else base.partition(".")[0]
            if base or node.level:
                yield name, base, node.level
            for alias in node.names:
                yield name, f"{base}.{alias.name}".lstrip("."), node.level


def defined_names(source: bytes) -> list[str] | None:
    """The names that a module binds when it is imported, in no order; None if only running it can tell."""
    try:
        table = symtable.symtable(source.decode("utf-8-sig"), "<source>", "exec")
        star = any(isinstance(node, ast.ImportFrom) and node.names[0].name == "*" for node in nodes(parse(source)))
    except _UNREADABLE:
        return None
    if star or {"globals", "exec", "setattr", "vars"} & set(table.get_identifiers()):
        return None
    return [symbol.get_name() for symbol in table.get_symbols() if symbol.is_assigned() or symbol.is_imported()]


def defined_classes(source: bytes) -> list[str]:
    """The classes that a module defines at its top level; none if it does not parse."""
    try:
        return list(_Module.read(source).classes)
    except _UNREADABLE:
        return []


def defining_file(root: Path, module: str, name: str) -> tuple[Path, str] | None:
    """Return the file below a folder that defines a class, and the name of the class there.

    Args:
        root: the folder that imports start from.
        module: a dotted name.
        name: a name that the module defines, or imports from another module below `root`.
    """
    place = Place(root, module)
    file = place.find(root / module, module)
    for _ in range(_DEEPEST):
        if file is None:
            return None
        try:
            read = _Module.read(file.read_bytes()[: MAX_SOURCE + 1])
        except (OSError, *_UNREADABLE):
            return None
        if name in read.classes:
            return file, name
        source, _, name = read.imported.get(name, "").partition(":")
        dotted = source.lstrip(".")
        file = place.find(file, dotted, len(source) - len(dotted)) if source and name else None
    return None


def defines_environment(source: bytes, path: Path) -> bool:
    """Whether a file defines a class that derives from ``gymnasium.Env`` and can be instantiated.

    Bases are followed through the file and its project. A base of an installed package counts if its name ends with
    ``Env``. A file that does not parse counts if it mentions a class and Gymnasium.

    Args:
        source: the file.
        path: where it is, for the modules of its project.
    """
    if len(source) > MAX_SOURCE or b"class " not in source:
        return False
    try:
        module = _Module.read(source)
    except _UNREADABLE:
        return b"gym" in source
    place = Place.of(path)
    return any(_concrete(module, name, path, place) for name in module.classes)


class _Module(msgspec.Struct):
    """What a module binds at its top level: classes, and the dotted names of what it imports, with leading dots."""

    classes: dict[str, ast.ClassDef] = {}
    imported: dict[str, str] = {}

    @classmethod
    def read(cls, source: bytes) -> _Module:
        """Read a source. Raises one of `_UNREADABLE`."""
        module = cls()
        for node in _statements(parse(source)):
            if isinstance(node, ast.ClassDef):
                module.classes[node.name] = node
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    top = alias.name.partition(".")[0]
                    module.imported[alias.asname or top] = alias.name if alias.asname else top
            elif isinstance(node, ast.ImportFrom):
                base = "." * node.level + (node.module or "")
                for alias in node.names:
                    module.imported[alias.asname or alias.name] = f"{base}:{alias.name}"
        return module


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    """The statements that run when a module is imported, without the bodies of classes and functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield child
        if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _statements(child)


def _concrete(module: _Module, name: str, path: Path, place: Place) -> bool:
    """Whether a class is an environment that leaves no method to its subclasses."""
    methods = [node for node in module.classes[name].body if isinstance(node, ast.FunctionDef)]
    return not any(map(_is_abstract, methods)) and _derives(module, name, path, place, _DEEPEST)


def _is_abstract(method: ast.FunctionDef) -> bool:
    """Whether a method is declared abstract, or is one that Gymnasium requires and only raises."""
    if any("abstract" in ast.dump(decorator) for decorator in method.decorator_list):
        return True
    body = [node for node in method.body if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))]
    refuses = [isinstance(node, ast.Raise) and "NotImplementedError" in ast.dump(node) for node in body]
    return method.name in ("reset", "step") and bool(body) and all(refuses)


def _derives(module: _Module, name: str, path: Path, place: Place, left: int) -> bool:
    """Whether a class of a module derives from ``gymnasium.Env``, through at most `left` classes."""
    for base in module.classes[name].bases if left else ():
        words = ast.unparse(base.value if isinstance(base, ast.Subscript) else base)
        if words in module.classes:
            found = words != name and _derives(module, words, path, place, left - 1)
        else:
            found = _imports_environment(module, words, path, place, left)
        if found:
            return True
    return False


def _imports_environment(module: _Module, words: str, path: Path, place: Place, left: int) -> bool:
    """Whether a dotted name that a module has imported is a class of environments."""
    first, _, rest = words.partition(".")
    source, _, name = module.imported.get(first, "").partition(":")
    parts = [part for part in (name, *rest.split(".")) if part]
    if not source or not parts or not left:
        return False
    dotted = source.lstrip(".")
    level, top = len(source) - len(dotted), dotted.partition(".")[0]
    if top in _GYMNASIUM and parts[-1] == "Env" and not level:
        return True
    # The last part is the class; any before it may name modules.
    for cut in range(len(parts) - 1, -1, -1):
        file = place.find(path, ".".join([*filter(None, [dotted]), *parts[:cut]]), level)
        if file is None:
            continue
        try:
            other = _Module.read(file.read_bytes()[: MAX_SOURCE + 1])
        except (OSError, *_UNREADABLE):
            return False
        if parts[-1] in other.classes:
            return _derives(other, parts[-1], file, Place.of(file), left - 1)
        return _imports_environment(other, parts[-1], file, Place.of(file), left - 1)
    # What an installed package calls an environment is one.
    return not level and parts[-1].endswith("Env") and parts[-1] not in _OTHER_ENVS
