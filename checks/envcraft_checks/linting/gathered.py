"""What the code says of things that the player must gather all of."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .logic import names_success
from .program import Function, Program, name_of
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
    """The numbers with which success compares counts: attributes to which step() adds one."""
    ranges = Ranges(program)
    counts, goals = set(), []
    for function in program.reached("step"):
        for node in function.nodes:
            match node:
                case ast.AugAssign(target=target, op=ast.Add(), value=ast.Constant(value=1)):
                    counts.add(function.field(target))
                case ast.Compare(left=left, ops=[ast.GtE() | ast.Eq()], comparators=[right]) if _wins(program, node):
                    goals.append((function.field(left), ranges.constant(right, function)))
    return {number for field, number in goals if field and field in counts and number is not None}


def _wins(program: Program, test: ast.AST) -> bool:
    """Whether a test is part of what the code calls success, by the names that it decides."""
    node = test
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
    decided = node.body if isinstance(node, ast.If) else [node]
    parts = [part for statement in decided for part in ast.walk(statement)]
    names = {part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    for part in parts:
        if isinstance(part, ast.Assign):
            names |= {name_of(target) for target in part.targets}
    return any(map(names_success, names))


def changed_in_play(program: Program) -> set[str]:
    """The attributes that functions change which step() may call and reset() does not."""
    functions = set(program.reached("step")) - set(program.reached("reset"))
    bound = {function.field(target) for function in functions for target, _, _ in function.bindings}
    return bound | {function.field(target) for function in functions for target, _ in function.writes}
