"""Parts of a list that a test of a float keeps for ever."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Program, Suspect, line
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
                    read = _nonzero(test)
                    for loop in function.nodes:
                        if read and isinstance(loop, ast.For) and function.field(loop.iter) == field:
                            for change in ast.walk(loop):
                                match change:
                                    case ast.AugAssign(op=ast.Sub(), value=amount) if (
                                        ast.unparse(change.target).partition("[")[2] == read.partition("[")[2]
                                        and (step := ranges.constant(amount, function)) is not None
                                        and 64 * step % 1
                                    ):
                                        words = f"keeps a part of self.{field} until {read} is exactly 0"
                                        yield Suspect(line(node), f"{words}, which subtracting {step:g} passes")


def _nonzero(test: ast.expr) -> str:
    """What a test compares with zero, as text."""
    match test:
        case ast.Subscript() | ast.Attribute():
            return ast.unparse(test)
        case ast.Compare(left=left, ops=[ast.NotEq()], comparators=[ast.Constant(value=0)]):
            return ast.unparse(left)
    return ""
