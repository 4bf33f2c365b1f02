"""The environments that files define, as their text says: class statements, their bases in other files, and names that
are assigned. No code runs here.
"""

from __future__ import annotations

import ast
import symtable
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec

from envcraft.model.project import UNREADABLE, Place
from envcraft.model.target import MAX_SOURCE, nodes, parse

#: Maximum number of modules that a class is followed through, and of the parts of a name.
_DEEPEST = 20
#: Maximum number of names that a class is followed through.
_MOST_NAMES = 1_000
#: The packages that define the base class of environments.
_GYMNASIUM = frozenset({"gymnasium", "gym"})
#: Bases of installed packages that are for many environments or agents at once, and do not derive from that class.
_OTHER_ENVS = frozenset({"AECEnv", "ParallelEnv", "VecEnv", "VectorEnv"})


def defined_names(source: bytes) -> list[str] | None:
    """The names that a module binds when it is imported, in no order; None if only running it can tell."""
    try:
        table = symtable.symtable(source.decode("utf-8-sig"), "<source>", "exec")
        star = any(isinstance(node, ast.ImportFrom) and node.names[0].name == "*" for node in nodes(parse(source)))
    except UNREADABLE:
        return None
    if star or {"globals", "exec", "setattr", "vars"} & set(table.get_identifiers()):
        return None
    return [symbol.get_name() for symbol in table.get_symbols() if symbol.is_assigned() or symbol.is_imported()]


def no_class(source: bytes, name: str) -> str:
    """What a name of a module is, such as ``a function``, if its only statement shows that it is no class of an
    environment; else "".
    """
    try:
        bound = [node for node in _statements(parse(source)) if name in _names_of(node)]
    except UNREADABLE:
        return ""
    match bound:
        case [ast.FunctionDef(decorator_list=[]) | ast.AsyncFunctionDef(decorator_list=[])]:
            return "a function"
        case [ast.Import()]:
            return "a module"
        case [ast.Assign(value=ast.Constant() | ast.List() | ast.Dict() | ast.Tuple() | ast.Set() | ast.JoinedStr())]:
            return "a value"
        case [ast.ClassDef(bases=[], keywords=[], decorator_list=[], body=body)]:
            methods = {node.name for node in body if isinstance(node, ast.FunctionDef)}
            return "" if {"reset", "step"} <= methods else "a class without a base"
    return ""


def _names_of(statement: ast.stmt) -> list[str]:
    """The names that a statement binds, without those of the statements in it."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [statement.name]
    if isinstance(statement, ast.Import | ast.ImportFrom):
        return [alias.asname or alias.name.partition(".")[0] for alias in statement.names]
    targets = [node for node in ast.walk(statement) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    return [target.id for target in targets]


def defined_classes(source: bytes) -> list[str]:
    """The classes that a module defines at its top level; none if it does not parse."""
    try:
        return list(_Module.read(source, Path()).classes)
    except UNREADABLE:
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
            read = _Module.read(file.read_bytes()[: MAX_SOURCE + 1], file)
        except (OSError, *UNREADABLE):
            return None
        if name in read.classes:
            return file, name
        source, _, name = read.imported.get(name, [""])[-1].partition(":")
        dotted = source.lstrip(".")
        file = place.find(file, dotted, len(source) - len(dotted)) if source and name else None
    return None


def environment_line(source: bytes, path: Path) -> int | None:
    """Return the line of the first class of a file that derives from ``gymnasium.Env`` and can be instantiated.

    Bases are followed through the file and its project: through names that are assigned or imported, also with ``*``,
    and through functions that return a class. A base of an installed package counts if its name ends with ``Env``. A
    base that only a call can tell counts if the file imports Gymnasium and the class has ``reset`` and ``step``. What
    ``type()`` or a function of the file makes counts if it is assigned to its own name. A file that does not parse
    counts from its first line if it mentions a class and Gymnasium.

    Args:
        source: the file.
        path: where it is, for the modules of its project.

    Returns:
        The line; None if the file defines no environment.
    """
    if len(source) > MAX_SOURCE or not any(words in source for words in (b"class ", b"type(")):
        return None
    bases = _Bases()
    try:
        module = _Module.read(source, path)
        found = [node.lineno for name in module.classes if (node := bases.environment(module, name)) is not None]
        assigned = ((name, value) for name, values in module.assigned.items() for value in values)
        found += [value.lineno for name, value in assigned if bases.make(module, name, value)]
    except UNREADABLE:
        return 1 if b"class " in source and b"gym" in source else None
    return min(found, default=None)


#: A class by its file and name.
Class = tuple[Path, str]


def derivation(source: bytes, path: Path) -> tuple[set[Class], set[Class]]:
    """Find how the environments of a file derive from each other and from those of other files.

    Args:
        source: the file.
        path: where it is, for the modules of its project.

    Returns:
        The classes of other files that they derive from; and they themselves if all of them lack ``reset`` or ``step``,
        as their source and that of all their bases shows, or have these call a method that only raises
        NotImplementedError; else nothing.
    """
    bases = _Bases()
    try:
        module = _Module.read(source, path)
        names = [name for name in module.classes if bases.environment(module, name) is not None]
        derived = {each for name in names for each in bases.derived_from(module, name)}
        made = any(bases.make(module, name, value) for name, values in module.assigned.items() for value in values)
        lacking = not made and all(bases.lacks_methods(module, name) or bases.refuses(module, name) for name in names)
    except UNREADABLE:
        return set(), set()
    own = {(path.resolve(), name) for name in names} if lacking else set()
    return {(other.path.resolve(), name) for other, name in derived if other is not module}, own


class _Module(msgspec.Struct, eq=False):
    """What a module, or a function of it, binds.

    Attributes:
        path: its file.
        classes: the classes.
        functions: the functions.
        assigned: the values of names.
        imported: the dotted names of what is imported, with leading dots.
        starred: the modules whose names are all imported, with leading dots.
    """

    path: Path
    classes: dict[str, ast.ClassDef] = {}
    functions: dict[str, ast.FunctionDef] = {}
    assigned: dict[str, list[ast.expr]] = {}
    imported: dict[str, list[str]] = {}
    starred: list[str] = []

    @classmethod
    def read(cls, source: bytes, path: Path) -> _Module:
        """Read a source. Raises one of `UNREADABLE`."""
        module = cls(path)
        module.bind(parse(source))
        return module

    def within(self, function: ast.FunctionDef) -> _Module:
        """What a function of the module sees."""
        assigned, imported = ({name: [*all_] for name, all_ in each.items()} for each in (self.assigned, self.imported))
        inner = _Module(self.path, {**self.classes}, {**self.functions}, assigned, imported, self.starred)
        inner.bind(function)
        return inner

    def bind(self, tree: ast.AST) -> None:
        """Add what the statements of a module or function bind."""
        for node in _statements(tree):
            if isinstance(node, ast.ClassDef):
                self.classes[node.name] = node
            elif isinstance(node, ast.FunctionDef):
                self.functions[node.name] = node
            elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                    if isinstance(target, ast.Name):
                        self.assigned.setdefault(target.id, []).append(node.value)
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    top = alias.name.partition(".")[0]
                    self.imported.setdefault(alias.asname or top, []).append(alias.name if alias.asname else top)
            elif isinstance(node, ast.ImportFrom):
                base = "." * node.level + (node.module or "")
                for alias in node.names:
                    self.imported.setdefault(alias.asname or alias.name, []).append(f"{base}:{alias.name}")
                self.starred += [base] if node.names[0].name == "*" else []

    def has_neither(self, words: str) -> bool:
        """Whether a dotted name means ``gymnasium.Env`` or a class of the standard library."""
        first, _, rest = words.partition(".")
        sources = self.imported.get(first, ())
        tops = {source.partition(":")[0].partition(".")[0] for source in sources}
        last = rest or "".join(source.partition(":")[2] for source in sources)
        own = first in self.classes or first in self.assigned
        return not own and bool(tops) and (tops <= sys.stdlib_module_names or (tops <= _GYMNASIUM and last == "Env"))


def _bound(body: list[ast.stmt]) -> Iterator[str]:
    """The names of the methods of a class, and of what it assigns."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name
        elif isinstance(node, ast.Assign):
            yield from (target.id for target in node.targets if isinstance(target, ast.Name))


def _statements(node: ast.AST) -> Iterator[ast.stmt]:
    """The statements that run when a module is imported, without the bodies of classes and functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.stmt):
            yield child
        if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _statements(child)


def _concrete(node: ast.ClassDef) -> bool:
    """Whether a class leaves no method to its subclasses."""
    return not any(_is_abstract(method) for method in node.body if isinstance(method, ast.FunctionDef))


def _is_abstract(method: ast.FunctionDef) -> bool:
    """Whether a method is declared abstract, or is one that Gymnasium requires and only raises."""
    if any("abstract" in ast.dump(decorator) for decorator in method.decorator_list):
        return True
    return method.name in ("reset", "step") and _refuses(method)


def _refuses(method: ast.FunctionDef) -> bool:
    """Whether a method only raises NotImplementedError."""
    body = [node for node in method.body if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))]
    return bool(body) and all(isinstance(node, ast.Raise) and "NotImplementedError" in ast.dump(node) for node in body)


class _Bases:
    """Follows the bases of classes through a file and its project, without running anything."""

    def __init__(self) -> None:
        self._modules: dict[Path, _Module | None] = {}
        self._scopes: dict[ast.FunctionDef, _Module] = {}

    def environment(self, module: _Module, name: str) -> ast.ClassDef | None:
        """The definition of a class that may be an environment; None if it is none, as far as its source shows."""
        node = module.classes.get(name)
        if node is None or not _concrete(node) or not (self._lead(module, [name]) or _may_derive(module, node)):
            return None
        return node

    def make(self, module: _Module, name: str, value: ast.expr) -> bool:
        """Whether an expression makes an environment of this name, by ``type()`` or in a function of the module."""
        function = module.functions.get(ast.unparse(value.func)) if isinstance(value, ast.Call) else None
        if function is None:
            return self._typed(module, name, value)
        inner, returned = self._returned(module, function)
        names = [each.id for each in returned if isinstance(each, ast.Name)]
        values = [*returned, *(each for local in names for each in inner.assigned.get(local, ()))]
        made = name in names and self.environment(inner, name) is not None
        return made or any(self._typed(inner, name, each) for each in values)

    def derived_from(self, module: _Module, name: str) -> set[tuple[_Module, str]]:
        """The classes of the project that a class derives from, itself included."""
        reached = {here for here in self._reached(module, [name]) if here is not None}
        return {(here, words) for here, words in reached if words in here.classes}

    def lacks_methods(self, module: _Module, name: str) -> bool:
        """Whether neither a class nor its bases, all of which are known, define both ``reset`` and ``step``."""
        defined: set[str] = set()
        pending = [(module, name)]
        for _ in range(_MOST_NAMES):
            if not pending:
                return not defined >= {"reset", "step"}
            here, words = pending.pop()
            if here.has_neither(words):
                continue
            node = here.classes.get(words)
            if node is not None:
                defined |= set(_bound(node.body))
                if not all(isinstance(base, ast.Name | ast.Attribute | ast.Subscript) for base in node.bases):
                    return False
            found = list(self._next(here, words))
            known = [each for each in found if each is not None]
            if len(known) < len(found) or (not known and (node is None or node.bases)):
                return False
            pending += known
        return False

    def refuses(self, module: _Module, name: str) -> bool:
        """Whether ``reset`` or ``step`` of a class calls one of its methods that only raises NotImplementedError."""
        methods: dict[str, ast.FunctionDef | None] = {}
        pending = [(module, name)]
        for _ in range(_MOST_NAMES):
            if not pending:
                break
            here, words = pending.pop(0)
            node = here.classes.get(words)
            own = {each.name: each for each in node.body if isinstance(each, ast.FunctionDef)} if node else {}
            bound = set(_bound(node.body)) if node else set()
            methods = {**{each: own.get(each) for each in bound}, **methods}
            pending += [each for each in self._next(here, words) if each is not None]
        called, reached = ["reset", "step"], set[str]()
        while called:
            method = methods.get(each := called.pop())
            if method is None or each in reached:
                continue
            if _refuses(method):
                return True
            reached.add(each)
            called += [
                node.func.attr
                for node in ast.walk(method)
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and _is_self(method, node.func)
            ]
        return False

    def _typed(self, module: _Module, name: str, value: ast.expr) -> bool:
        """Whether a call of ``type()`` makes an environment; its name may be known only when it runs."""
        match value:
            case ast.Call(func=ast.Name("type"), args=[named, bases, _]):
                other = isinstance(named, ast.Constant) and named.value != name
                parts = bases.elts if isinstance(bases, ast.Tuple) else [bases]
                return not other and self._lead(module, [each for part in parts for each in _names(part)])
        return False

    def _lead(self, module: _Module, names: list[str]) -> bool:
        """Whether one of some names of a module means ``gymnasium.Env``, or what derives from it."""
        return None in self._reached(module, names)

    def _reached(self, module: _Module, names: list[str]) -> Iterator[tuple[_Module, str] | None]:
        """Some names of a module and all that they mean or derive from; None for an environment of a package."""
        # Names that end with () mean what a call returns.
        pending = [(module, name) for name in names]
        seen: set[tuple[_Module, str]] = set()
        while pending and len(seen) < _MOST_NAMES:
            here = pending.pop()
            if here in seen or here[1].count(".") > _DEEPEST:
                continue
            seen.add(here)
            yield here
            for found in self._next(*here):
                if found is None:
                    yield None
                else:
                    pending.append(found)

    def _returned(self, module: _Module, function: ast.FunctionDef) -> tuple[_Module, list[ast.expr]]:
        """What a function of a module sees, and what it returns."""
        if function not in self._scopes:
            self._scopes[function] = module.within(function)
        returned = [node.value for node in _statements(function) if isinstance(node, ast.Return)]
        return self._scopes[function], [value for value in returned if value is not None]

    def _next(self, module: _Module, words: str) -> Iterator[tuple[_Module, str] | None]:
        """What a dotted name means, or derives from; None for a class of environments of an installed package."""
        first, _, rest = words.partition(".")
        rest = f".{rest}" if rest else ""
        if words in module.classes:
            for base in module.classes[words].bases:
                yield from ((module, each) for each in _names(base))
        function = module.functions.get(first.removesuffix("()")) if first.endswith("()") else None
        if function is not None:
            inner, returned = self._returned(module, function)
            yield from ((inner, each + rest) for value in returned for each in _names(value))
        for value in module.assigned.get(first, ()):
            yield from ((module, each + rest) for each in _names(value))
        yield from self._imported(module, words)

    def _imported(self, module: _Module, words: str) -> Iterator[tuple[_Module, str] | None]:
        """What a dotted name means that a module imports."""
        first, _, rest = words.partition(".")
        called = "()" if first.endswith("()") else ""
        first = first.removesuffix("()")
        bound = first in module.imported or first in module.classes
        starred = [] if bound else [f"{source}:{first}" for source in module.starred]
        for source, _, name in (each.partition(":") for each in (*module.imported.get(first, ()), *starred)):
            parts = [part for part in (name + called if name else "", *rest.split(".")) if part]
            if parts:
                yield from self._of(module, source, parts)

    def _of(self, module: _Module, source: str, parts: list[str]) -> Iterator[tuple[_Module, str] | None]:
        """What the parts of a dotted name mean that follow the name of a module."""
        dotted = source.lstrip(".")
        level, top = len(source) - len(dotted), dotted.partition(".")[0]
        if top in _GYMNASIUM and parts[-1] == "Env" and not level:
            yield None
            return
        # The last part is the class; any before it may name modules.
        for cut in range(len(parts) - 1, -1, -1):
            path = ".".join([*filter(None, [dotted]), *parts[:cut]])
            file = Place.of(module.path).find(module.path, path, level)
            if file is not None:
                if (other := self._read(file)) is not None:
                    yield other, parts[-1]
                return
        # What an installed package calls an environment is one.
        if not level and parts[-1].endswith("Env") and parts[-1] not in _OTHER_ENVS:
            yield None

    def _read(self, file: Path) -> _Module | None:
        """A file of the project; None if it cannot be read, or if too many have been read."""
        if file not in self._modules and len(self._modules) < _DEEPEST:
            try:
                self._modules[file] = _Module.read(file.read_bytes()[: MAX_SOURCE + 1], file)
            except (OSError, *UNREADABLE):
                self._modules[file] = None
        return self._modules.get(file)


def _is_self(method: ast.FunctionDef, attribute: ast.Attribute) -> bool:
    """Whether an attribute is one of the object that a method is called on."""
    value, first = attribute.value, method.args.args[:1]
    return isinstance(value, ast.Name) and [value.id] == [each.arg for each in first]


def _names(value: ast.expr) -> Iterator[str]:
    """The dotted names that an expression for a class may mean; those of calls end with ()."""
    if isinstance(value, ast.Subscript):
        yield from _names(value.value)
    elif isinstance(value, ast.IfExp | ast.BoolOp):
        for each in [value.body, value.orelse] if isinstance(value, ast.IfExp) else value.values:
            yield from _names(each)
    elif isinstance(value, ast.Call):
        yield from (f"{name}()" for name in _names(value.func))
        if not _wraps(value):
            # A function that makes a class of another one, such as ``with_metaclass``.
            yield from (name for each in value.args for name in _names(each))
    elif isinstance(value, ast.Name | ast.Attribute):
        words = ast.unparse(value)
        if all(part.isidentifier() for part in words.split(".")):
            yield words


def _may_derive(module: _Module, node: ast.ClassDef) -> bool:
    """Whether a class has what an environment has, and a base that only running the module can tell."""
    if not _GYMNASIUM & {
        name.partition(".")[0].partition(":")[0] for each in module.imported.values() for name in each
    }:
        return False
    values = [value for base in node.bases for value in (base, *module.assigned.get(ast.unparse(base), ()))]
    methods = {method.name for method in node.body if isinstance(method, ast.FunctionDef)}
    return {"reset", "step"} <= methods and any(isinstance(each, ast.Call) and not _wraps(each) for each in values)


def _wraps(call: ast.Call) -> bool:
    """Whether a call names wrappers, which are no environments of their own."""
    return "wrapper" in ast.unparse(call).lower()
