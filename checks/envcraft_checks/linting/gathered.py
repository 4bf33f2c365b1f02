"""What the code says of things that the player must gather all of."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program
from .ranges import Ranges


def emptied(program: Program) -> set[str]:
    """The attributes that step() tests for being empty."""
    return {
        field for function in program.reached("step") for node in function.nodes for field in _empty(node, function)
    }


def _empty(node: ast.AST, function: Function) -> Iterator[str]:
    match node:
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield from {function.field(operand)} - {""}
        case ast.Compare(left=ast.Call(func=ast.Name(id="len"), args=[counted]), comparators=[ast.Constant(value=0)]):
            yield from {function.field(counted)} - {""}


def counted(program: Program) -> set[float]:
    """The numbers that step() compares its counts with: attributes to which it adds one."""
    ranges = Ranges(program)
    counts, goals = set(), []
    for function in program.reached("step"):
        for node in function.nodes:
            match node:
                case ast.AugAssign(target=target, op=ast.Add(), value=ast.Constant(value=1)):
                    counts.add(function.field(target))
                case ast.Compare(left=left, ops=[ast.GtE() | ast.Eq()], comparators=[right]):
                    goals.append((function.field(left), ranges.constant(right, function)))
    return {number for field, number in goals if field and field in counts and number is not None}


def changed_in_play(program: Program) -> set[str]:
    """The attributes that functions change which step() may call and reset() does not."""
    functions = set(program.reached("step")) - set(program.reached("reset"))
    bound = {function.field(target) for function in functions for target, _, _ in function.bindings}
    return bound | {function.field(target) for function in functions for target, _ in function.writes}
