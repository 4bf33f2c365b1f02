"""What is the same in every episode of an instance: numbers, and what is counted from them."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, arguments, name_of, root

_COUNTS = frozenset({"abs", "enumerate", "int", "len", "max", "min", "range"})


def repeats(program: Program, node: ast.AST | None, function: Function, pending: frozenset[str] = frozenset()) -> bool:
    """Whether an expression takes the same numbers in every episode: a constant, the number of a level.

    Args:
        program: the file.
        node: the expression.
        function: in which it is.
        pending: the names and attributes whose values are being looked at: what is counted from itself repeats.
    """
    match node:
        case ast.Constant():
            return True
        case ast.Tuple(elts=parts) | ast.List(elts=parts):
            return all(repeats(program, one, function, pending) for one in parts)
        case ast.BinOp(left=left, right=right):
            return repeats(program, left, function, pending) and repeats(program, right, function, pending)
        case ast.Call(args=parts, keywords=[]) if name_of(node) in _COUNTS and isinstance(node.func, ast.Name):
            return all(repeats(program, one, function, pending) for one in parts)
        case ast.Attribute() if function.field(node):
            name = f"{program.bound_to(function)}.{node.attr}"
            return name in pending or _counted(program, node, function, pending | {name})
        case ast.Name():
            name = f"{function.owner}.{function.name}.{node.id}"
            values = [*_bound(program, node, function)] if name not in pending else []
            return name in pending or (bool(values) and all(repeats(program, *one, pending | {name}) for one in values))
    return False


def _counted(program: Program, node: ast.Attribute, function: Function, pending: frozenset[str]) -> bool:
    """Whether reset() sets an attribute to such a number, and play only adds such numbers to it."""
    owner, resetting = program.bound_to(function), program.reached("reset")
    known = program.class_values(owner).get(node.attr)
    values = program.field_values(owner).get(node.attr, [])
    if not values:
        return known is not None and repeats(program, known[1], function, pending)
    again = any(one in resetting for _, one in values) or not any(one in program.play for _, one in values)
    written = (
        (one, place)
        for one in program.methods(owner)
        for place, statement in one.writes
        if one.field(place) == node.attr and not (isinstance(statement, ast.AugAssign) and one not in resetting)
    )
    return again and next(written, None) is None and all(repeats(program, *one, pending) for one in values)


def _bound(program: Program, node: ast.Name, function: Function) -> Iterator[tuple[ast.AST | None, Function]]:
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
    if node.id in function.parameters:
        for caller in program.all:
            for call in caller.nodes:
                if isinstance(call, ast.Call) and program.called(call, caller) is function:
                    yield from ((value, caller) for name, value in arguments(call, function) if name == node.id)
