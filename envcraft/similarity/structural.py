"""The layer ``structural``: the same program under other names.

The key is a digest of the syntax tree in which numbers replace names: the names that a function or the module binds, in
the order of first use, and the attributes that the file defines (methods, names in a class body, assignment targets).
Other names, such as ``range``, ``np.zeros`` or the module of an import, stay. Docstrings, annotations and comments are
left out.

Constants stay: they hold levels, speeds and rewards, and two games on one engine often differ in nothing else. The
layer ``near`` measures how much a few constants matter.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator

from envcraft.similarity.reading import read_tree

#: Version of the keys. A new version invalidates stored keys.
VERSION = 1

_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
#: Nodes that hold bound names as strings.
_NAMING = ast.ExceptHandler | ast.Global | ast.Nonlocal | ast.MatchAs | ast.MatchStar
#: Fields that do not affect what a program does.
_LEFT_OUT = frozenset({"ctx", "type_comment", "type_ignores", "kind", "annotation", "returns"})


def key(source: bytes) -> bytes | None:
    """The key of a source, 16 bytes; None if it does not parse or is nested too deeply."""
    tree = read_tree(source)
    if tree is None:
        return None
    writer = _Writer(tree)
    try:
        writer.write(tree)
    except (RecursionError, ValueError):
        # ValueError: an integer with more digits than Python converts to text.
        return None
    return hashlib.blake2b("\0".join(writer.words).encode("utf-8", "surrogatepass"), digest_size=16).digest()


class _Scope:
    """Names that a function or the module binds, numbered in the order of first use."""

    def __init__(self, names: set[str]) -> None:
        self.names = names
        self.numbers: dict[str, int] = {}

    def number(self, name: str) -> int:
        return self.numbers.setdefault(name, len(self.numbers))


class _Writer:
    """Writes a tree as a list of `words`."""

    def __init__(self, tree: ast.Module) -> None:
        self.words: list[str] = []
        declared = {name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names}
        self._scopes = [_Scope(_bound(tree.body) | declared)]
        self._attributes = _Scope(set(_defined(tree)))
        self._callables = {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        self._keywords = _Scope({node.arg for node in ast.walk(tree) if isinstance(node, ast.arg)})

    def write(self, node: ast.AST) -> None:
        """Write a node and all below it. Raises RecursionError, ValueError."""
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return
        if isinstance(node, ast.Name):
            self.words.append(self._name(node.id))
        elif isinstance(node, ast.Attribute):
            self.words.append(self._attribute(node.attr))
            self.write(node.value)
        elif isinstance(node, ast.Constant):
            self.words.append(f"{type(node.value).__name__}={node.value!r}")
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            self._function(node)
        elif isinstance(node, ast.ClassDef):
            self.words += ["ClassDef", self._name(node.name)]
            self._fields(node, ("bases", "keywords", "decorator_list"))
            self._class_body(node)
        elif isinstance(node, ast.alias):
            self.words += ["alias", node.name, self._name(node.asname or node.name.partition(".")[0])]
        elif isinstance(node, ast.Call):
            self._call(node)
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            # As if it had no annotation.
            self.write(ast.Assign([node.target], node.value))
        else:
            self.words.append(type(node).__name__)
            self._fields(node, [name for name in node._fields if name not in _LEFT_OUT])

    def _fields(self, node: ast.AST, names: tuple[str, ...] | list[str]) -> None:
        for name in names:
            value = getattr(node, name, None)
            if isinstance(value, ast.AST):
                self.write(value)
            elif isinstance(value, list):
                self.words.append("[")
                for item in value:
                    self._item(node, item)
                self.words.append("]")
            else:
                self._item(node, value)

    def _item(self, node: ast.AST, item: object) -> None:
        """Write the value of a field: a node, or a string that may be a name."""
        if isinstance(item, ast.AST):
            self.write(item)
        elif isinstance(item, str) and isinstance(node, _NAMING):
            self.words.append(self._name(item))
        else:
            self.words.append(repr(item))

    def _call(self, node: ast.Call) -> None:
        self.words.append("Call")
        self._fields(node, ("func", "args"))
        called = getattr(node.func, "id", getattr(node.func, "attr", None))
        for keyword in node.keywords:
            name = keyword.arg
            # Only functions of the file itself have parameters that it can rename.
            own = called in self._callables and name in self._keywords.names
            self.words.append(f"%={self._keywords.number(str(name))}" if own else f"{name}=")
            self.write(keyword.value)
        self.words.append(")")

    def _function(self, node: _Function) -> None:
        if not isinstance(node, ast.Lambda):
            self.words += [type(node).__name__, self._name(node.name)]
            self._fields(node, ("decorator_list",))
        else:
            self.words.append("Lambda")
        arguments = node.args
        # Defaults are evaluated in the enclosing scope.
        self._fields(arguments, ("defaults", "kw_defaults"))
        given = _arguments(arguments)
        body = node.body if isinstance(node.body, list) else [node.body]
        self._scopes.append(_Scope({argument.arg for argument in given} | _bound(body)))
        for kind in ("posonlyargs", "args", "kwonlyargs"):
            self.words.append(kind)
            self.words += [self._name(argument.arg) for argument in getattr(arguments, kind)]
        for starred in (arguments.vararg, arguments.kwarg):
            self.words.append("*" if starred is None else self._name(starred.arg))
        self.words.append("{")
        for part in body:
            self.write(part)
        self.words.append("}")
        self._scopes.pop()

    def _class_body(self, node: ast.ClassDef) -> None:
        # Methods reach names of the class body as attributes.
        self._scopes.append(self._attributes)
        self.words.append("{")
        for part in node.body:
            self.write(part)
        self.words.append("}")
        self._scopes.pop()

    def _name(self, name: str) -> str:
        for depth, scope in enumerate(reversed(self._scopes)):
            # A method does not see the names of its class.
            if name in scope.names and (scope is not self._attributes or depth == 0):
                return f"%{'a' if scope is self._attributes else depth}:{scope.number(name)}"
        return name

    def _attribute(self, name: str) -> str:
        attributes = self._attributes
        return f".%{attributes.number(name)}" if name in attributes.names else f".{name}"


def _arguments(arguments: ast.arguments) -> list[ast.arg]:
    starred = [argument for argument in (arguments.vararg, arguments.kwarg) if argument is not None]
    return [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, *starred]


def _defined(tree: ast.Module) -> Iterator[str]:
    """The attributes that a file defines: assignment targets, and names that class bodies bind."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load):
            yield node.attr
        elif isinstance(node, ast.ClassDef):
            yield from _bound(node.body)


def _bound(body: list[ast.stmt] | list[ast.expr]) -> set[str]:
    """The names that statements bind in their own scope, comprehensions included."""
    found: set[str] = set()
    elsewhere: set[str] = set()
    waiting: list[ast.AST] = list(body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
            waiting += node.decorator_list
            continue
        if isinstance(node, ast.Lambda):
            continue
        if isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load):
            found.add(node.id)
        elif isinstance(node, ast.alias):
            found.add(node.asname or node.name.partition(".")[0])
        elif isinstance(node, ast.Global | ast.Nonlocal):
            elsewhere.update(node.names)
        elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
            found.add(node.name)
        waiting += ast.iter_child_nodes(node)
    return found - elsewhere
