"""What is the same in every episode of an instance: numbers, and what is counted from them."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, arguments, name_of, root

#: An expression and the function that it is in.
_Value = tuple[ast.AST | None, Function]
_COUNTS = frozenset({"abs", "enumerate", "int", "len", "max", "min", "range"})


def repeats(program: Program, node: ast.AST | None, function: Function) -> bool:
    """Whether an expression takes the same numbers in every episode: a constant, the number of a level.

    Args:
        program: the file.
        node: the expression.
        function: in which it is.
    """
    waiting: list[_Value] = [(node, function)]
    seen: set[str] = set()
    while waiting:
        one, where = waiting.pop()
        name = ""
        if isinstance(one, ast.Name):
            name = f"{where.owner}.{where.name}.{one.id}"
        elif isinstance(one, ast.Attribute):
            name = f"{program.bound_to(where)}.{one.attr}"
        # What is counted from itself repeats.
        if name and name in seen:
            continue
        seen.add(name)
        made_of = _made_of(program, one, where)
        if made_of is None:
            return False
        waiting += made_of
    return True


def _made_of(program: Program, node: ast.AST | None, function: Function) -> list[_Value] | None:
    """What must repeat for an expression to repeat; None if it does not."""
    match node:
        case ast.Constant():
            return []
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            return [(one, function) for one in parts]
        case ast.BinOp(left=left, right=right):
            return [(left, function), (right, function)]
        case ast.Call(args=parts, keywords=[]) if name_of(node) in _COUNTS and isinstance(node.func, ast.Name):
            return [(one, function) for one in parts]
        case ast.Attribute() if function.field(node):
            return _counted(program, node, function)
        case ast.Name():
            return [*_bound(program, node, function)] or None
    return None


def _counted(program: Program, node: ast.Attribute, function: Function) -> list[_Value] | None:
    """The numbers that reset() gives an attribute, and play adds to it; None if it goes on from episode to episode."""
    owner, resetting = program.bound_to(function), program.reached("reset")
    values = program.field_values(owner).get(node.attr, [])
    for one in program.methods(owner):
        for place, statement in one.writes:
            added = isinstance(statement, ast.AugAssign) and one not in resetting
            if one.field(place) == node.attr and not added:
                return None
    if not values:
        known = program.class_values(owner).get(node.attr)
        return [(known[1], function)] if known is not None else None
    again = [value for value, one in values if one in resetting]
    if not again and any(one in program.play for _, one in values):
        return None
    itself = (
        one.attr for value in again if value is not None for one in ast.walk(value) if isinstance(one, ast.Attribute)
    )
    return None if node.attr in itself else [*values]


def _bound(program: Program, node: ast.Name, function: Function) -> Iterator[_Value]:
    """What a name may stand for: what is assigned, what a loop goes through, what the callers give."""
    if node.id not in function.local:
        yield program.module_values.get(node.id), function
        return
    for target, value, statement in function.bindings:
        if isinstance(target, ast.Name) and target.id == node.id:
            yield (statement.iter if isinstance(statement, ast.For) else value), function
    for one in function.nodes:
        if isinstance(one, ast.comprehension) and name_of(root(one.target)) == node.id:
            yield one.iter, function
        if isinstance(one, ast.AugAssign) and isinstance(one.target, ast.Name) and one.target.id == node.id:
            yield one.value, function
    if node.id in function.parameters:
        for caller in program.all:
            for call in caller.nodes:
                if isinstance(call, ast.Call) and program.called(call, caller) is function:
                    yield from ((value, caller) for name, value in arguments(call, function) if name == node.id)
