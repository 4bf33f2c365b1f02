"""State of the game that drawing changes."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line

_COMPUTED = (ast.BinOp, ast.UnaryOp, ast.IfExp)


def drawn_changes(program: Program) -> Iterator[Suspect]:
    """Find attributes that render() computes from their last value, and by which step() decides without drawing."""
    drawing = program.reached("render")
    play = [function for function in program.reached("step") if function not in drawing]
    read = {
        field: node
        for function in play
        for node in function.nodes
        if isinstance(node, ast.If | ast.IfExp | ast.While | ast.Compare | ast.BinOp)
        for part in _deciding(node)
        if (field := function.field(part))
    }
    for function in drawing:
        for node in function.nodes:
            if (field := _advanced(node, function)) in read:
                yield Suspect(line(node), f"changes self.{field} while it draws, and line {line(read[field])} reads it")


def _deciding(node: ast.If | ast.IfExp | ast.While | ast.Compare | ast.BinOp) -> Iterator[ast.AST]:
    match node:
        case ast.Compare(left=left, comparators=others):
            yield from (left, *others)
        case ast.BinOp(left=left, right=right):
            yield from (left, right)
        case _:
            yield node.test


def _advanced(node: ast.AST, function: Function) -> str:
    """The attribute that a statement computes from its last value, "" if there is none."""
    match node:
        case ast.AugAssign(target=target):
            return function.field(target)
        case ast.Assign(targets=[target], value=value) if isinstance(value, _COMPUTED):
            field = function.field(target)
            return field if any(function.field(part) == field for part in ast.walk(value)) else ""
    return ""
