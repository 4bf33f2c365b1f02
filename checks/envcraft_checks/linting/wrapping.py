"""Numbers that wrap around below zero: indices, and NumPy's unsigned integers."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterator

from .program import Function, Program, Suspect, arguments, line, name_of
from .ranges import Ranges

_UNSIGNED = frozenset({"uint", "uint16", "uint32", "uint64", "uint8"})
#: What keeps an index from being negative, or a difference from passing zero.
_GUARDS = re.compile(r"[<>]=? ?-?[01]\b|\b-?[01] ?[<>]=?|\bmax\(|\bclip\(|%|\babs\(|in range\(|\bmaximum\(")
_DEPTH = 3


def wrapped_indices(program: Program) -> Iterator[Suspect]:
    """Find moves whose only test of the border is IndexError, which a negative index does not raise."""
    for function in program.play:
        if _GUARDS.search(ast.unparse(function.node)):
            continue
        for node in function.nodes:
            if isinstance(node, ast.Try) and any(_catches(one) for one in node.handlers):
                for one in _indices(node):
                    if _goes_down(program, one, function):
                        words = (
                            f"tests {ast.unparse(one)[:40]} only by IndexError, which a negative index does not raise: "
                            "it counts from the end"
                        )
                        yield Suspect(line(one), words, certain=False)
                        break


def _catches(handler: ast.ExceptHandler) -> bool:
    kinds = handler.type.elts if isinstance(handler.type, ast.Tuple) else [handler.type]
    return any(one is not None and name_of(one) == "IndexError" for one in kinds)


def _indices(node: ast.Try) -> Iterator[ast.expr]:
    for statement in node.body:
        for one in ast.walk(statement):
            if isinstance(one, ast.Subscript):
                parts = one.slice.elts if isinstance(one.slice, ast.Tuple) else [one.slice]
                yield from (part for part in parts if not isinstance(part, ast.Slice))


def _goes_down(program: Program, node: ast.expr | None, function: Function | None, depth: int = _DEPTH) -> bool:
    """Whether a number may be one less than another, as far as that shows."""
    if node is None or function is None or depth == 0:
        return False
    match node:
        case ast.BinOp(op=ast.Sub(), left=left):
            return not isinstance(left, ast.Call | ast.Constant)
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            # A position and a way, such as x + dx.
            return not isinstance(left, ast.Constant) and not isinstance(right, ast.Constant | ast.Call)
        case ast.Call(func=ast.Name(id="int"), args=[one]):
            return _goes_down(program, one, function, depth)
        case ast.Name(id=name) if name in function.parameters:
            calls = [
                (dict(arguments(call, function)).get(name), caller)
                for caller in program.play
                for call in caller.nodes
                if isinstance(call, ast.Call) and program.called(call, caller) is function
            ]
            return any(
                _goes_down(program, value, caller, depth - 1) and not _GUARDS.search(ast.unparse(caller.node))
                for value, caller in calls
            )
        case ast.Name():
            if any(name_of(target) == node.id and _subtracts(one) for target, one in function.writes):
                return True
            return any(_goes_down(program, value, one, depth - 1) for value, one in program.values(node, function))
    return False


def _subtracts(node: ast.AST) -> bool:
    return isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Sub)


def empty_slices(program: Program) -> Iterator[Suspect]:
    """Find areas that a test reads from an index which may be -1, where the slice has no cells."""
    ranges = Ranges(program)
    for function in program.reached("step"):
        for node in function.nodes:
            if not isinstance(node, ast.Subscript) or not _is_summed(program, node, function):
                continue
            for part in node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]:
                if not isinstance(part, ast.Slice) or part.lower is None or part.upper is None:
                    continue
                field, low = _start(program, ranges, part.lower, function)
                if field and -math.inf < low < 0 and not _is_tested(program, field):
                    words = f"reads {ast.unparse(node)[:50]}, which is empty if it starts at {low:g}"
                    yield Suspect(line(node), words)


def _is_summed(program: Program, node: ast.expr, function: Function) -> bool:
    """Whether the code asks whether some cell of an area is set, which may have a name first."""
    match program.parents[node]:
        case ast.Assign(targets=[ast.Name(id=name)]):
            read = [each for each in function.nodes if isinstance(each, ast.Name) and each.id == name]
            return any(isinstance(each.ctx, ast.Load) and _is_asked(program, each) for each in read)
    return _is_asked(program, node)


def _is_asked(program: Program, node: ast.expr) -> bool:
    parent = program.parents[node]
    match parent, program.parents[parent]:
        case (ast.Attribute(attr="any" | "sum" | "max"), ast.Call()):
            return True
        case (ast.Call(), _):
            return name_of(parent) in ("any", "count_nonzero")
    return False


def _start(program: Program, ranges: Ranges, node: ast.expr, function: Function) -> tuple[str, float]:
    """The attribute from which a number is subtracted, and the lowest result."""
    if isinstance(node, ast.Name):
        values = program.values(node, function)
        if len(values) != 1 or values[0][0] is None or values[0][1] is not function:
            return "", 0.0
        node = values[0][0]
    match node:
        case ast.BinOp(op=ast.Sub(), left=left, right=right) if field := function.field(left):
            amount = ranges.constant(right, function)
            # A border that play may reach: the least value to which a statement limits it.
            limited = [
                ranges.range(value, one)[0]
                for value, one in program.field_values(program.env).get(field, ())
                if value is not None and name_of(value) in ("min", "max", "clip")
            ]
            border = min((low for low in limited if low > -math.inf), default=math.inf)
            return (field, border - amount) if amount is not None else ("", 0.0)
    return "", 0.0


def _is_tested(program: Program, field: str) -> bool:
    """Whether a step compares an attribute with anything, such as with the border, before or after the area is read."""
    return any(
        isinstance(node, ast.Compare) and any(function.field(part) == field for part in ast.walk(node))
        for function in program.reached("step")
        for node in function.nodes
    )


def unsigned(program: Program) -> Iterator[Suspect]:
    """Find unsigned integers of NumPy that are tested for a negative value, or that a subtraction takes past zero."""
    fields = {
        field
        for field, values in program.field_values(program.env).items()
        if values and all(is_unsigned(program, value, function) for value, function in values)
    }
    if not fields:
        return
    ranges = Ranges(program)
    steep = {
        field: node
        for function in program.play
        for node in function.nodes
        if isinstance(node, ast.AugAssign)
        and _subtracts(node)
        and (field := function.field(_whole(node.target))) in fields
        and not _is_guarded(program, function, node, field)
        and ranges.constant(_plain(node.value), function) != 1
    }
    for function in program.play:
        for node in function.nodes:
            match node:
                case ast.Compare(left=left, ops=[op], comparators=[ast.Constant(value=0)]):
                    field = function.field(_whole(left))
                case ast.UnaryOp(op=ast.Not() as op, operand=left):
                    field = function.field(left)
                case _:
                    continue
            if field in fields and isinstance(op, ast.Lt):
                yield Suspect(line(node), f"tests {ast.unparse(node)}, but {ast.unparse(left)} is unsigned")
            elif field in steep and isinstance(op, ast.LtE | ast.Eq | ast.Gt | ast.NotEq | ast.Not):
                words = (
                    f"subtracts more than 1 from the unsigned self.{field}, which wraps around below zero, and line "
                    f"{line(node)} tests {ast.unparse(node)}"
                )
                yield Suspect(line(steep[field]), words, certain=False)


def _whole(node: ast.expr) -> ast.expr:
    return node.value if isinstance(node, ast.Subscript) else node


def _plain(node: ast.expr) -> ast.expr:
    """What a call such as ``np.uint8(2)`` or ``int(2)`` is given."""
    return node.args[0] if isinstance(node, ast.Call) and len(node.args) == 1 else node


def is_unsigned(program: Program, node: ast.expr | None, function: Function, depth: int = _DEPTH) -> bool:
    """Whether an expression is an array of NumPy's unsigned integers, or a function of the file returns only such."""
    if isinstance(node, ast.Call) and (called := program.called(node, function)) is not None:
        results = [one.value for one in called.nodes if isinstance(one, ast.Return)]
        known = bool(results) and depth > 0
        return known and all(is_unsigned(program, one, called, depth - 1) for one in results)
    if not isinstance(node, ast.Call) or not program.path(node.func, function).startswith("numpy."):
        return False
    kinds = [keyword.value for keyword in node.keywords if keyword.arg == "dtype"]
    if name_of(node) in ("zeros", "ones", "empty", "array"):
        kinds += node.args[1:2]
    elif name_of(node) == "full":
        kinds += node.args[2:3]
    else:
        kinds.append(node.func)
    return bool(kinds) and all(name_of(kind) in _UNSIGNED for kind in kinds)


def _is_guarded(program: Program, function: Function, node: ast.AST, field: str) -> bool:
    """Whether a test of the same value, or a bound of what is subtracted, comes before a subtraction."""
    if isinstance(node, ast.AugAssign) and re.search(r"\b(min|minimum|clip)\(", ast.unparse(node.value)):
        return True
    while node is not function.node:
        node = program.parents[node]
        if isinstance(node, ast.If | ast.While) and any(function.field(one) == field for one in ast.walk(node.test)):
            return True
    return False
