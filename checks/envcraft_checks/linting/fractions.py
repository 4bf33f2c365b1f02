"""Fractions that lose all of their value when they become a whole number."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

_DEPTH = 4
_DYNAMIC = frozenset({"__dict__", "setattr", "vars"})


def vanishing_fractions(program: Program) -> Iterator[Suspect]:
    """Find ``int(x)`` where `x` is always drawn between -1 and 1, so the result is always 0."""
    names = {name_of(node) for node in program.nodes if isinstance(node, ast.Name | ast.Attribute)}
    defined = {node.name for node in program.nodes if isinstance(node, ast.FunctionDef)}
    if names & _DYNAMIC or defined & {"random", "uniform"}:
        return
    for function in program.reached("reset", "step", "render"):
        for node in function.nodes:
            match node:
                case ast.Call(func=ast.Name(id="int"), args=[value]) if _fraction(program, value, function, _DEPTH):
                    yield Suspect(line(node), f"uses {ast.unparse(node)[:50]}, which is always 0")


def _fraction(program: Program, node: ast.expr | None, function: Function | None, depth: int) -> bool:
    """Whether a value is always 0 or drawn between -1 and 1."""
    match node:
        case ast.Constant(value=0 | 0.0):
            return True
        case ast.Call(func=ast.Attribute(attr="random"), args=[], keywords=[]):
            return True
        case ast.Call(func=ast.Attribute(attr="uniform"), args=[low, high], keywords=[]):
            numbers = [_number(low), _number(high)]
            return all(number is not None and abs(number) <= 1 for number in numbers)
        case ast.Call(func=ast.Name(id="float" | "abs"), args=[inner]) | ast.UnaryOp(op=ast.USub(), operand=inner):
            return _fraction(program, inner, function, depth)
        case ast.Name(id=name) if depth and function is not None:
            given = {one.arg for one in ast.walk(function.node) if isinstance(one, ast.arg)}
            added = any(name_of(target) == name for target, _ in function.writes)
            return not added and name not in given and _all_fractions(program, node, function, depth)
        case ast.Attribute(attr=name) if depth and function is not None and function.field(node):
            stores = [one for one in program.nodes if isinstance(one, ast.Attribute) and one.attr == name]
            stores = [one for one in stores if isinstance(one.ctx, ast.Store)]
            plain = all(isinstance(program.parents[one], ast.Assign | ast.AnnAssign) for one in stores)
            mine = sum(len(values) for values in [program.field_values(program.bound_to(function)).get(name, [])])
            return plain and mine == len(stores) and _all_fractions(program, node, function, depth)
    return False


def _all_fractions(program: Program, node: ast.expr, function: Function, depth: int) -> bool:
    values = program.values(node, function)
    drawn = [value for value, _ in values if not isinstance(value, ast.Constant)]
    return bool(drawn) and all(_fraction(program, value, owner, depth - 1) for value, owner in values)


def _number(node: ast.expr) -> float | None:
    try:
        value = ast.literal_eval(node)
    except ValueError:
        return None
    return float(value) if isinstance(value, int | float) else None
