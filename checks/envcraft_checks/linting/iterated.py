"""Loops that remove items from what they iterate over."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Program, Suspect, line, name_of

#: Methods of a dict that iterate over it.
_VIEWS = frozenset({"items", "keys", "values"})
_LISTS = frozenset({"list", "sorted"})
#: What raises an error if its size changes while a loop iterates over it.
_RAISE = frozenset({"Counter", "defaultdict", "deque", "dict", "set"})
#: The most characters of a container that a message repeats.
_SHOWN = 40


def shrinking_loops(program: Program) -> Iterator[Suspect]:
    """Find loops that remove their item from the list, dict, set or deque that they iterate over, and go on.

    A list then skips the next item, which is suspicious. A dict, a set or a deque raises an error, which is certain.
    """
    for function in program.reached("reset", "step", "render"):
        for loop in function.nodes:
            if not isinstance(loop, ast.For):
                continue
            container = _container(loop.iter)
            removal = next(_removals(loop, container), None) if container is not None else None
            if container is None or removal is None or _leaves(loop, removal) or _refills(loop, container):
                continue
            values = [value for value, _ in program.values(container, function)]
            text = ast.unparse(container)[:_SHOWN]
            if values and all(map(_raises, values)):
                words = f"changes the size of {text} in a loop over it, which raises RuntimeError"
                yield Suspect(line(removal), words)
            elif values and all(map(_is_list, values)):
                words = f"removes an item of {text} in a loop over it, so the loop skips the next item"
                yield Suspect(line(removal), words, certain=False)


def _container(node: ast.expr) -> ast.expr | None:
    """What a loop iterates over by a name or an attribute; None if it may be a copy."""
    match node:
        case ast.Call(func=ast.Attribute(value=container, attr=attr), args=[]) if attr in _VIEWS:
            return container
        case ast.Call(func=ast.Name("enumerate"), args=[container, *_]):
            return _container(container)
        case ast.Name() | ast.Attribute():
            return node
    return None


def _removals(loop: ast.For, container: ast.expr) -> Iterator[ast.AST]:
    """The nodes of a loop's body that take the loop's item out of its container."""
    items = {ast.dump(ast.Name(each.id, ast.Load())) for each in ast.walk(loop.target) if isinstance(each, ast.Name)}
    for node in _running(loop.body):
        match node:
            case ast.Call(func=ast.Attribute(value=owner, attr="discard" | "pop" | "remove"), args=[taken]):
                pass
            case ast.Delete(targets=[ast.Subscript(value=owner, slice=taken)]):
                pass
            case ast.Call(func=ast.Attribute(value=owner, attr="popleft" | "popitem")):
                if ast.dump(owner) == ast.dump(container):
                    yield node
                continue
            case _:
                continue
        if ast.dump(owner) == ast.dump(container) and ast.dump(taken) in items:
            yield node


def _running(nodes: list[ast.stmt]) -> Iterator[ast.AST]:
    """The nodes of statements in the order of the text, without functions that they only define."""
    for node in nodes:
        waiting: list[ast.AST] = [node]
        while waiting:
            one = waiting.pop()
            if not isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                yield one
                waiting += reversed(list(ast.iter_child_nodes(one)))


def _leaves(loop: ast.For, removal: ast.AST) -> bool:
    """Whether the loop may end after the removal, because a statement that ends a loop comes later in its body."""
    return any(
        isinstance(node, ast.Assert | ast.Break | ast.Raise | ast.Return)
        and (node.end_lineno or node.lineno) >= line(removal)
        for node in _running(loop.body)
    )


def _refills(loop: ast.For, container: ast.expr) -> bool:
    """Whether the body gives the container's name another object, or puts items into the container."""
    for node in _running(loop.body):
        match node:
            case ast.Name(ctx=ast.Store()) | ast.Attribute(ctx=ast.Store()):
                if ast.unparse(node) == ast.unparse(container):
                    return True
            case (
                ast.Call(func=ast.Attribute(value=owner, attr="add" | "insert" | "setdefault"))
                | ast.Subscript(value=owner, ctx=ast.Store())
            ) if ast.dump(owner) == ast.dump(container):
                return True
    return False


def _raises(value: ast.expr | None) -> bool:
    """Whether a value raises an error if its size changes in a loop over it."""
    match value:
        case ast.Dict() | ast.DictComp() | ast.Set() | ast.SetComp():
            return True
        case ast.Call(func=func):
            return name_of(func) in _RAISE
    return False


def _is_list(value: ast.expr | None) -> bool:
    match value:
        case ast.List() | ast.ListComp():
            return True
        case ast.Call(func=ast.Name(id=name)):
            return name in _LISTS
    return False
