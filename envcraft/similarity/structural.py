"""The layer ``structural``: the same program under other names.

The syntax tree is written out with names in place of which their number stands: the names that a function binds, in the
order in which it mentions them, likewise those of the module, and the attributes that the file itself defines (methods,
what a class body binds, what is assigned to). Names from elsewhere, such as ``range``, ``np.zeros`` or the module of an
import, stay as they are. Docstrings, annotations and comments are left out.

Constants are kept: numbers and strings are where levels, speeds and rewards are written, so that two games on one
engine often differ in nothing else. How much a few of them matter is for the layer ``near`` to say.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator

from .reading import read_tree

#: Of the keys: another one makes those that were kept worthless.
VERSION = 1

_Function = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
#: Nodes with names that the file binds as plain words.
_NAMING = ast.ExceptHandler | ast.Global | ast.Nonlocal | ast.MatchAs | ast.MatchStar
#: Fields that say nothing about what a program does.
_LEFT_OUT = frozenset({"ctx", "type_comment", "type_ignores", "kind", "annotation", "returns"})


def key(source: bytes) -> bytes | None:
    """The key of a source, 16 bytes; None where it does not parse, or nests too deeply to be walked."""
    tree = read_tree(source)
    if tree is None:
        return None
    writer = _Writer(tree)
    try:
        writer.write(tree)
    except (RecursionError, ValueError):
        # The latter: an integer of more digits than Python writes.
        return None
    return hashlib.blake2b("\0".join(writer.words).encode("utf-8", "surrogatepass"), digest_size=16).digest()


class _Scope:
    """Names that a function or the module binds, numbered as they are met."""

    def __init__(self, names: set[str]) -> None:
        self.names = names
        self.numbers: dict[str, int] = {}

    def number(self, name: str) -> int:
        return self.numbers.setdefault(name, len(self.numbers))


class _Writer:
    """Writes a tree out as `words`."""

    def __init__(self, tree: ast.Module) -> None:
        self.words: list[str] = []
        told = {name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names}
        self._scopes = [_Scope(_bound(tree.body) | told)]
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
        """What stands in a field: a node, or a word that may be a name."""
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
            # Only what the file itself defines has parameters that it may call otherwise.
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
        # Defaults are those of the scope around.
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
        # What is bound here is reached as an attribute, by the methods too.
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
    """The attributes that a file defines: those assigned to, and what its class bodies bind."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load):
            yield node.attr
        elif isinstance(node, ast.ClassDef):
            yield from _bound(node.body)


def _bound(body: list[ast.stmt] | list[ast.expr]) -> set[str]:
    """The names that statements bind in their own scope; those of comprehensions are counted to it."""
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
