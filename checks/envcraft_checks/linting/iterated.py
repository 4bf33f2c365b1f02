"""Loops that remove items from what they iterate over."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

#: Methods that take an item away.
_REMOVES = frozenset({"discard", "pop", "popitem", "popleft", "remove"})
#: Methods of a dict that iterate over it.
_VIEWS = frozenset({"items", "keys", "values"})
#: What raises an error if its size changes while a loop iterates over it.
_RAISES = frozenset({"Counter", "OrderedDict", "defaultdict", "deque", "dict", "set"})
#: The most characters of a test or a container that a message repeats.
_SHOWN = 40


def shrinking_loops(program: Program) -> Iterator[Suspect]:
    """Find loops that remove an item from what they iterate over, and go on.

    A list then skips the next item. A dict, a set or a deque raises an error. It is certain where that happens, and
    where a skipped item has no second chance, because a test compares it with a count of steps.
    """
    for function in program.reached("reset", "step", "render"):
        for loop in function.nodes:
            if not isinstance(loop, ast.For):
                continue
            container, raises = _iterated(program, loop.iter, function)
            for node in ast.walk(loop) if container is not None else ():
                if _removes(node, container) and not _leaves(program, node, loop):
                    yield _suspect(program, function, loop, node, container, raises)
                    break


def _iterated(program: Program, node: ast.expr, function: Function) -> tuple[ast.expr | None, bool]:
    """The container of a loop, None if the loop has a copy, and whether a change of its size raises an error."""
    match node:
        case ast.Call(func=ast.Attribute(value=container, attr=attr), args=[]) if attr in _VIEWS:
            return container, True
        case ast.Call(func=ast.Name("enumerate"), args=[container, *_]):
            return _iterated(program, container, function)
        case ast.Name() | ast.Attribute():
            values = [value for value, _ in program.values(node, function)]
            return node, bool(values) and all(map(_has_fixed_size, values))
    return None, False


def _has_fixed_size(value: ast.expr | None) -> bool:
    match value:
        case ast.Dict() | ast.DictComp() | ast.Set() | ast.SetComp():
            return True
        case ast.Call(func=func):
            return name_of(func) in _RAISES
    return False


def _removes(node: ast.AST, container: ast.expr | None) -> bool:
    """Whether a node takes an item out of the container."""
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr=attr)):
            changed = [value] if attr in _REMOVES else []
        case ast.Delete(targets=targets):
            changed = [target.value for target in targets if isinstance(target, ast.Subscript)]
        case _:
            return False
    return container is not None and any(ast.dump(each) == ast.dump(container) for each in changed)


def _leaves(program: Program, node: ast.AST, loop: ast.For) -> bool:
    """Whether the loop ends after a node: by a statement after it in one of the blocks that hold it."""
    while node is not loop:
        block = program.block(node)
        later = block[block.index(node) + 1 :] if isinstance(node, ast.stmt) and node in block else []
        if isinstance(node, ast.Return | ast.Raise):
            return True
        if any(isinstance(each, ast.Break | ast.Return | ast.Raise) for each in later):
            return True
        node = program.parents[node]
    return False


def _suspect(
    program: Program, function: Function, loop: ast.For, node: ast.AST, container: ast.expr | None, raises: bool
) -> Suspect:
    assert container is not None
    text = ast.unparse(container)[:_SHOWN]
    if raises:
        return Suspect(line(node), f"changes the size of {text} in a loop over it, which then raises RuntimeError")
    words = f"removes items of {text} in a loop over it, which then skips the next item"
    once = _held_once(program, function, loop, node)
    if once is None:
        return Suspect(line(node), words, certain=False)
    return Suspect(line(node), f"{words}, for which {ast.unparse(once)[:_SHOWN]} holds only once")


def _held_once(program: Program, function: Function, loop: ast.For, node: ast.AST) -> ast.Compare | None:
    """The test around a removal that compares an item with a count of steps, which no later step is equal to."""
    items = {each.id for each in ast.walk(loop.target) if isinstance(each, ast.Name)}
    for outer in program.around(node, function):
        if outer is loop:
            break
        match outer:
            case ast.If(test=ast.Compare(left=left, ops=[ast.Eq()], comparators=[right]) as test):
                for side, other in ((left, right), (right, left)):
                    read = {each.id for each in ast.walk(side) if isinstance(each, ast.Name)}
                    if read & items and _counts(program, function.field(other)):
                        return test
    return None


def _counts(program: Program, field: str) -> bool:
    """Whether all that a step does with an attribute of self, if it changes it, is to add to it."""
    steps = program.reached("step")
    if not field or any(one.field(target) == field for one in steps for target, _, _ in one.bindings):
        return False
    changes = [node for one in steps for target, node in one.writes if one.field(target) == field]
    return bool(changes) and all(isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add) for node in changes)
