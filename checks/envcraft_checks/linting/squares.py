"""Squared distances that a test compares with a distance."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

_DISTANCE = re.compile(r"(^|_)(radius|range|reach|dist|distance)($|_)", re.IGNORECASE)
_SQUARED = re.compile(r"sq|2|square", re.IGNORECASE)
_DIFFERENCE = re.compile(r"^(d|diff|delta|offset)_?[a-z]?$|^[dx]?[xy]$", re.IGNORECASE)


def squared_distances(program: Program) -> Iterator[Suspect]:
    """Find a sum of squares that a test compares with a radius, a reach or a range that is not squared.

    The file must also use the number as a length: in a sum, or as what it gives a function, for example to draw a
    circle. A perfect square may be meant as one.
    """
    for function in program.all:
        for node in function.nodes:
            match node:
                case ast.Compare(left=left, ops=[ast.Lt() | ast.LtE() | ast.Gt() | ast.GtE()], comparators=[right]):
                    for squares, limit in ((left, right), (right, left)):
                        number = _length(program, limit, function)
                        if number is not None and _squared(program, squares, function):
                            name = name_of(limit)
                            words = f"compares a squared distance with {name} = {number:g}: {ast.unparse(node)[:60]}"
                            yield Suspect(line(node), words)


def _length(program: Program, limit: ast.expr, function: Function) -> float | None:
    """The number of a constant that is used as a length; None if it may be a square."""
    name = name_of(limit) if isinstance(limit, ast.Name | ast.Attribute) else ""
    if not _DISTANCE.search(name) or _SQUARED.search(name):
        return None
    match [value for value, _ in program.values(limit, function)]:
        case [ast.Constant(value=int() | float() as number)] if number > 1 and math.sqrt(number) % 1:
            read = [node for node in program.nodes if type(node) is type(limit) and name_of(node) == name]
            return number if any(_is_length(program, node) for node in read) else None
    return None


def _is_length(program: Program, node: ast.AST) -> bool:
    parent = program.parents[node]
    match parent:
        case ast.BinOp(op=ast.Add() | ast.Sub()):
            return True
        case ast.Call(func=func, args=arguments):
            return node in arguments and name_of(func) not in ("float", "int", "isqrt", "range", "sqrt")
    return False


def _squared(program: Program, node: ast.expr, function: Function, again: bool = True) -> bool:
    """Whether an expression is the sum of the squares of differences."""
    match node:
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _is_square(left) and _is_square(right)
        case ast.Call(func=ast.Attribute(value=value, attr="sum")) if isinstance(value, ast.BinOp):
            return _is_square(value)
        case ast.Call(func=func, args=[value, *_]) if program.path(func, function) == "numpy.sum":
            return _is_square(value)
        case ast.Name(id=name) if again:
            changed = any(name_of(target) == name for target, _ in function.writes)
            values = [value for value, _ in program.values(node, function)]
            return (
                not changed
                and len(values) == 1
                and values[0] is not None
                and _squared(program, values[0], function, False)
            )
    return False


def _is_square(node: ast.expr) -> bool:
    """Whether an expression is the square of a difference, or of what is named like one."""
    match node:
        case ast.BinOp(left=left, op=ast.Mult(), right=right) if ast.unparse(left) == ast.unparse(right):
            pass
        case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=2)):
            pass
        case _:
            return False
    return (isinstance(left, ast.BinOp) and isinstance(left.op, ast.Sub)) or bool(_DIFFERENCE.search(name_of(left)))
