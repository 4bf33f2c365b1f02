"""Parts of a list that a test of a float keeps for ever."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line
from .ranges import Ranges


def lasting_parts(program: Program) -> Iterator[Suspect]:
    """Find lists that keep a part until a float in it is exactly zero, which a loop only subtracts from."""
    ranges = Ranges(program)
    for function in program.play:
        for target, value, node in function.bindings:
            match value:
                case ast.ListComp(
                    elt=ast.Name(id=kept),
                    generators=[ast.comprehension(target=ast.Name(id=part), iter=held, ifs=[test])],
                ) if kept == part and (field := function.field(held)) and function.field(target) == field:
                    if (read := _tested(test)) is not None and (
                        step := _subtracted(program, ranges, function, field, read)
                    ):
                        words = f"keeps a part of self.{field} until {ast.unparse(read)} is exactly 0"
                        yield Suspect(line(node), f"{words}, but subtracting {step:g} skips 0")


def _tested(test: ast.expr) -> ast.expr | None:
    """What a test compares with zero."""
    match test:
        case ast.Subscript() | ast.Attribute():
            return test
        case ast.Compare(left=ast.Subscript() | ast.Attribute() as left, ops=[ast.NotEq()]) if _is_zero(test):
            return left
    return None


def _is_zero(test: ast.Compare) -> bool:
    return isinstance(test.comparators[0], ast.Constant) and test.comparators[0].value == 0


def _subtracted(program: Program, ranges: Ranges, function: Function, field: str, read: ast.expr) -> float | None:
    """What a loop over a list subtracts from a place in each part, if no float counts down to zero in such steps and
    nothing else in play assigns that place.
    """
    for loop in function.nodes:
        if isinstance(loop, ast.For) and function.field(loop.iter) == field:
            for change in ast.walk(loop):
                if (
                    isinstance(change, ast.AugAssign)
                    and isinstance(change.op, ast.Sub)
                    and _is_same(change.target, read)
                ):
                    step = ranges.constant(change.value, function)
                    others = (target for one in program.play for target, _, _ in one.bindings)
                    if step is not None and 64 * step % 1 and not any(_is_same(other, read) for other in others):
                        return step
    return None


def _is_same(node: ast.expr, read: ast.expr) -> bool:
    """Whether two expressions name the same attribute, or the same item, of a part."""
    match node, read:
        case ast.Attribute(attr=one), ast.Attribute(attr=other):
            return one == other
        case ast.Subscript(slice=one), ast.Subscript(slice=other):
            return ast.unparse(one) == ast.unparse(other)
    return False
