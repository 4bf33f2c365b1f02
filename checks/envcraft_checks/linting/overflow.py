"""Arithmetic of unsigned arrays that wraps around: distances below zero, and colours above 255."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of
from .ranges import Ranges
from .wrapping import is_unsigned

_DISTANCES = frozenset({"abs", "absolute", "hypot", "norm"})
_HIGHEST = 255


def overflows(program: Program) -> Iterator[Suspect]:
    """Find distances of unsigned arrays, and numbers of 8 bits that a multiplication takes past 255."""
    ranges = Ranges(program)
    unsigned = {
        field
        for field, values in program.field_values(program.env).items()
        if values and all(is_unsigned(program, value, function) for value, function in values)
    }
    for function in program.play:
        for node in function.nodes:
            match node:
                case ast.BinOp(op=ast.Sub(), left=left, right=right) if _measures(program, node):
                    if _field(function, left) in unsigned and _field(function, right) in unsigned:
                        words = f"takes a distance of unsigned arrays, which wraps around below zero: {_text(node)}"
                        yield Suspect(line(node), words)
                case ast.BinOp(op=ast.Mult(), left=left, right=right):
                    for one, other in ((left, right), (right, left)):
                        factor = ranges.constant(other, function)
                        whole = function.field(one) if _becomes_bytes(program, node) else ""
                        field = _bytes(function, one) or whole
                        if isinstance(factor, int) and field:
                            yield from _scaled(program, ranges, function, node, field, factor, bool(whole))


def _measures(program: Program, node: ast.BinOp) -> bool:
    """Whether only the size of a difference counts."""
    match program.parents[node]:
        case ast.Call(args=[first, *_]) as outer if first is node and name_of(outer) in _DISTANCES:
            call: ast.AST = outer
            # Whether two arrays differ at all is right in any case.
            while isinstance(call, ast.Attribute | ast.Call):
                if name_of(call) == "any":
                    return False
                call = program.parents[call]
            zero = any(isinstance(one, ast.Constant) and not one.value for one in ast.iter_child_nodes(call))
            return not (isinstance(call, ast.UnaryOp) or (isinstance(call, ast.Compare) and zero))
    return False


def _field(function: Function, node: ast.expr) -> str:
    while isinstance(node, ast.Subscript):
        node = node.value
    return function.field(node)


def _bytes(function: Function, node: ast.expr) -> str:
    """The attribute of which an expression is a copy in bytes, such as ``self.heat.astype(np.uint8)``."""
    match node:
        case ast.Call(func=ast.Attribute(attr="astype", value=value), args=[kind]) if name_of(kind) == "uint8":
            return _field(function, value)
    return ""


def _becomes_bytes(program: Program, node: ast.BinOp) -> bool:
    """Whether the result is copied in bytes, or a sum with it, such as ``(40 + 24 * self.heat).astype(np.uint8)``."""
    whole = program.parents[node]
    if not (isinstance(whole, ast.BinOp) and isinstance(whole.op, ast.Add)):
        whole = node
    attribute = program.parents[whole]
    call = program.parents[attribute] if isinstance(attribute, ast.Attribute) and attribute.attr == "astype" else None
    return isinstance(call, ast.Call) and [name_of(kind) for kind in call.args] == ["uint8"]


def _scaled(
    program: Program, ranges: Ranges, function: Function, node: ast.BinOp, field: str, factor: float, whole: bool
) -> Iterator[Suspect]:
    """Report a product of bytes that exceeds 255 for the highest number that a test leaves to an attribute, or to all
    items of it.
    """
    added, parent = 0.0, program.parents[node]
    if isinstance(parent, ast.BinOp) and isinstance(parent.op, ast.Add):
        added = ranges.constant(parent.right if parent.left is node else parent.left, function) or 0.0
    limits = []
    for one in program.play:
        for test in one.nodes:
            match test:
                case ast.Compare(left=left, ops=[ast.GtE()], comparators=[limit]) if _field(one, left) == field:
                    if whole and not one.field(left):
                        return
                    limits.append(ranges.constant(limit, one))
    if len(limits) == 1 and limits[0] is not None and (limits[0] - 1) * factor + added > _HIGHEST:
        words = f"computes {_text(node)} in 8 bits, which wraps around past 255: self.{field} reaches {limits[0] - 1:g}"
        yield Suspect(line(node), words)


def _text(node: ast.AST) -> str:
    return ast.unparse(node)[:50]
