"""Rewards that grow with a power of what play counts."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of
from .ranges import Ranges

_BOUNDS = frozenset({"clip", "log", "log1p", "min", "minimum", "sqrt", "tanh"})
_DEPTH = 3
#: The base from which a dozen events multiply a reward by more than 100.
_FAST = 1.5


def powers(program: Program) -> Iterator[Suspect]:
    """Find powers whose exponent is a counter that nothing limits, and that the reward contains."""
    ranges = Ranges(program)
    for function in program.reached("step"):
        if program.bound_to(function) != program.env:
            continue
        for node in function.nodes:
            match node:
                case (
                    ast.BinOp(left=base, op=ast.Pow() | ast.LShift(), right=exponent)
                    | ast.Call(func=ast.Attribute(attr="pow" | "power") | ast.Name(id="pow"), args=[base, exponent])
                ):
                    pass
                case _:
                    continue
            number = ranges.constant(base, function)
            shifts = isinstance(node, ast.BinOp) and isinstance(node.op, ast.LShift)
            if number is None or number < 1 or (number == 1 and not shifts):
                continue
            counter = _counter(program, exponent, function)
            if counter and _is_free(program, counter) and _is_paid(program, function, node):
                words = f"pays {ast.unparse(node)[:40]} as a reward, and nothing limits self.{counter}"
                certain = (shifts or number >= _FAST) and not _slows(exponent) and _starts_again(program, counter)
                yield Suspect(line(node), words, certain)


def _slows(exponent: ast.expr) -> bool:
    """Whether an exponent is a fraction of a counter."""
    return any(
        isinstance(one, ast.Div | ast.FloorDiv)
        or (isinstance(one, ast.Constant) and isinstance(one.value, float) and abs(one.value) < 1)
        for one in ast.walk(exponent)
    )


def _starts_again(program: Program, field: str) -> bool:
    """Whether play sets an attribute to zero, as it does with a streak that is broken."""
    return any(
        isinstance(part, ast.Constant) and part.value == 0
        for one in program.reached("step")
        for target, value, _ in one.bindings
        if value is not None and one.field(target) == field
        for part in _branches(value)
    )


def _runs_out(program: Program, block: list[ast.stmt], function: Function) -> bool:
    """Whether some statements take an item out of a list that play never fills."""
    taken = {
        function.field(call.func.value)
        for statement in block
        for call in ast.walk(statement)
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr in ("pop", "remove")
    } - {""}
    filled = {
        one.field(target)
        for one in program.reached("step")
        for target in [
            *(target for target, _, _ in one.bindings),
            *(target for target, node in one.writes if name_of(node) in ("append", "extend", "insert")),
        ]
    }
    return bool(taken - filled)


def _counter(program: Program, node: ast.expr, function: Function, depth: int = _DEPTH) -> str:
    """The attribute that an exponent grows with."""
    if depth == 0:
        return ""
    if field := function.field(node):
        return field
    match node:
        case ast.BinOp(
            op=ast.Add() | ast.Sub() | ast.FloorDiv() | ast.Div() | ast.Mult(), left=one, right=ast.Constant()
        ):
            return _counter(program, one, function, depth)
        case ast.BinOp(op=ast.Add() | ast.Mult(), left=ast.Constant(), right=one):
            return _counter(program, one, function, depth)
        case ast.Call(func=ast.Name(id="int" | "float"), args=[one]):
            return _counter(program, one, function, depth)
        case ast.Name():
            values = program.values(node, function)
            if len(values) == 1 and values[0][0] is not None and values[0][1] is function:
                return _counter(program, values[0][0], function, depth - 1)
    return ""


def _is_free(program: Program, field: str) -> bool:
    """Whether play adds to an attribute, and nothing limits or compares it."""
    grows = False
    for method in program.methods(program.env):
        for node in method.nodes:
            match node:
                case ast.AugAssign(target=target, op=op) if method.field(target) == field:
                    if not isinstance(op, ast.Add) or _runs_out(program, program.block(node), method):
                        return False
                    grows = True
                case ast.Assign(targets=targets, value=value) if field in map(method.field, targets):
                    added = [one for one in _branches(value) if _is_added(one, field, method)]
                    grows |= bool(added)
                    others = [one for one in _branches(value) if one not in added]
                    if any(isinstance(part, ast.Call | ast.BinOp) for one in others for part in ast.walk(one)):
                        return False
                case ast.Compare(left=left, comparators=comparators):
                    sides = [left, *comparators]
                    numbers = [one.value for one in sides if isinstance(one, ast.Constant)]
                    if field in map(method.field, sides) and numbers not in ([0], [1]):
                        return False
    return grows


def _branches(value: ast.expr) -> list[ast.expr]:
    """The values that an expression may have by its conditions."""
    return [*_branches(value.body), *_branches(value.orelse)] if isinstance(value, ast.IfExp) else [value]


def _is_added(value: ast.expr, field: str, method: Function) -> bool:
    """Whether an expression is an attribute and a number."""
    match value:
        case (
            ast.BinOp(left=one, op=ast.Add(), right=ast.Constant())
            | ast.BinOp(left=ast.Constant(), op=ast.Add(), right=one)
        ):
            return method.field(one) == field
    return False


def _is_paid(program: Program, function: Function, node: ast.AST, depth: int = _DEPTH) -> bool:
    """Whether what step() returns as the reward is calculated from a node, and nothing limits it on the way."""
    names = _made_of(function, node)
    for one in function.nodes:
        match one:
            case ast.Return(value=ast.Tuple(elts=[_, reward, *_])) if function.name == "step":
                if _holds(reward, names, node):
                    return True
            case ast.Return(value=ast.expr() as value) if function.name != "step" and _holds(value, names, node):
                calls = (
                    (call, caller)
                    for caller in program.reached("step")
                    for call in caller.nodes
                    if isinstance(call, ast.Call) and program.called(call, caller) is function
                )
                return depth > 0 and any(_is_paid(program, caller, call, depth - 1) for call, caller in calls)
    return False


def _made_of(function: Function, node: ast.AST) -> set[str]:
    """The names and attributes that statements of a function calculate from a node."""
    names: set[str] = set()
    size = -1
    while size < len(names):
        size = len(names)
        for one in function.nodes:
            match one:
                case ast.Assign(targets=[target], value=value) | ast.AugAssign(target=target, value=value):
                    plain = isinstance(target, ast.Name) or function.field(target)
                    if plain and _holds(value, names, node):
                        names.add(ast.unparse(target))
    limited = {
        ast.unparse(one.targets[0])
        for one in function.nodes
        if isinstance(one, ast.Assign)
        and any(isinstance(part, ast.Call) and name_of(part) in _BOUNDS for part in ast.walk(one.value))
    }
    return names - limited


def _holds(value: ast.expr, names: set[str], node: ast.AST) -> bool:
    """Whether a node, or something that is made of it, is a term of an expression."""
    match value:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() | ast.Mult(), right=right):
            return value is node or _holds(left, names, node) or _holds(right, names, node)
        case ast.IfExp(body=left, orelse=right):
            return _holds(left, names, node) or _holds(right, names, node)
        case ast.UnaryOp(operand=one):
            return _holds(one, names, node)
        case ast.Call(func=ast.Name(id="float" | "int" | "round"), args=[one, *_]):
            return value is node or _holds(one, names, node)
    return value is node or ast.unparse(value) in names
