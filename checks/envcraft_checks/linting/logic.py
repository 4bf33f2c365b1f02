"""Conditions that can never hold, and arithmetic that depends on chance."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterator

from .actions import Actions
from .program import Function, Program, Suspect, line, name_of
from .ranges import Ranges, decides

_MIRRORED = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE, ast.Eq: ast.Eq}
#: Parts of names that stand for success.
_SUCCESS = frozenset({"success", "victory", "win", "wins", "won"})
_ROOTS = frozenset({"dist", "hypot", "norm", "sqrt"})


def contradictions(program: Program) -> Iterator[Suspect]:
    """Find tests of the end, and of what an action does, that can never be true."""
    ranges, actions, misspelt = Ranges(program), Actions(program), _never_given(program)
    for function in program.play:
        if program.bound_to(function) != program.env:
            continue
        for node in function.nodes:
            if isinstance(node, ast.BoolOp) and _holds_false(node) and decides(program, node):
                yield Suspect(line(node), f"tests {ast.unparse(node)[:60]}, which is never true")
            if not isinstance(node, ast.Compare) or len(node.ops) != 1:
                continue
            if decides(program, node) or _lets_act(program, actions, node, function):
                for field_side, other, kind in (
                    (node.left, node.comparators[0], type(node.ops[0])),
                    (node.comparators[0], node.left, _MIRRORED.get(type(node.ops[0]))),
                ):
                    field, limit = _compared(ranges, field_side, other, function)
                    if difflib.get_close_matches(field, misspelt):
                        # A change under another spelling raises, so how far the field would go is not known.
                        continue
                    if (field or isinstance(field_side, ast.Call)) and limit is not None and kind is not None:
                        low, high = ranges.of(field) if field else ranges.range(field_side, function)
                        if _never(kind, low, high, limit):
                            below = kind in (ast.Gt, ast.GtE) or high < limit
                            bound = f"is never above {high:g}" if below else f"is never below {low:g}"
                            name = f"self.{field}" if field else ast.unparse(field_side)
                            yield Suspect(line(node), f"tests {ast.unparse(node)}, but {name} {bound}")
    yield from _never_set(program)


def _compared(ranges: Ranges, side: ast.expr, other: ast.expr, function: Function) -> tuple[str, float | None]:
    """The attribute on one side of a comparison, and the number that it is compared with."""
    field, limit = function.field(side), ranges.constant(other, function)
    match side:
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right) if function.field(left):
            moved = ranges.constant(right, function)
            if moved is not None and limit is not None:
                return function.field(left), limit - moved if isinstance(op, ast.Add) else limit + moved
    return field, limit


def _never_given(program: Program) -> set[str]:
    """The attributes that the environment changes by a number and never gives a value."""
    given = program.field_values(program.env).keys() | program.class_values(program.env).keys()
    own = program.methods(program.env)
    changed = {one.field(node.target) for one in own for node in one.nodes if isinstance(node, ast.AugAssign)}
    return changed - given - {""}


def _lets_act(program: Program, actions: Actions, node: ast.Compare, function: Function) -> bool:
    """Whether a part of an action has an effect only if a comparison holds, as `fire and self.shots > 0` does."""
    parent = program.parents[node]
    if not isinstance(parent, ast.BoolOp) or not isinstance(parent.op, ast.And):
        return False
    branch = program.parents[parent]
    chosen = any(actions.is_chosen(each, function) for each in parent.values if each is not node)
    return chosen and isinstance(branch, ast.If) and branch.test is parent


def _holds_false(node: ast.BoolOp) -> bool:
    return isinstance(node.op, ast.And) and any(map(is_false, node.values))


def _never_set(program: Program) -> Iterator[Suspect]:
    """Find flags of success that play reads, and that nothing ever makes true."""
    own = program.methods(program.env)
    foreign = {
        node.attr
        for node in program.nodes
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and not any(one.field(node) for one in own)
    }
    for field, values in program.field_values(program.env).items():
        if not names_success(field) or field in foreign or not all(is_false(value) for value, _ in values):
            continue
        for function in program.play:
            for node in function.nodes:
                if function.field(node) == field and isinstance(getattr(node, "ctx", None), ast.Load):
                    yield Suspect(line(node), f"reads self.{field}, which the code never sets to true")


def names_success(name: str) -> bool:
    """Whether a key, a variable or an attribute stands for success, as its name says."""
    return not _SUCCESS.isdisjoint(name.lower().split("_"))


def is_false(node: ast.AST | None) -> bool:
    """Whether an expression is the constant False."""
    return isinstance(node, ast.Constant) and node.value is False


def _never(kind: type[ast.cmpop], low: float, high: float, limit: float) -> bool:
    if kind is ast.GtE:
        return high < limit
    if kind is ast.Gt:
        return high <= limit
    if kind is ast.LtE:
        return low > limit
    if kind is ast.Lt:
        return low >= limit
    return kind is ast.Eq and (high < limit or low > limit)


def divisions(program: Program) -> Iterator[Suspect]:
    """Find divisions by a length or a distance that nothing compares with zero."""
    for function in program.play:
        tests = _tests(function)
        for node in function.nodes:
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div | ast.FloorDiv | ast.Mod):
                what = _may_be_zero(program, function, node.right)
                if what and not any(word in test for word in what for test in tests):
                    yield Suspect(line(node), f"divides by {ast.unparse(node.right)[:40]}, which may be zero")


def _tests(function: Function) -> list[str]:
    """The text of the expressions that the function tests or iterates over."""
    found: list[ast.AST] = []
    for node in function.nodes:
        match node:
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) | ast.Assert(test=test):
                found.append(test)
            case ast.BoolOp():
                found.append(node)
            case ast.For(iter=iterated) | ast.comprehension(iter=iterated):
                found.append(iterated)
            case ast.Try():
                found += [handler.type for handler in node.handlers if handler.type is not None]
    return [ast.unparse(one) for one in found]


def _may_be_zero(program: Program, function: Function, divisor: ast.expr) -> tuple[str, ...]:
    """The texts one of which a test must contain, if a divisor is a length or a distance."""
    if isinstance(divisor, ast.Name):
        values = program.values(divisor, function)
        if (
            len(values) == 1
            and values[0][0] is not None
            and not isinstance(values[0][0], ast.Name)
            and (inner := _may_be_zero(program, function, values[0][0]))
        ):
            return divisor.id, *inner
    if (
        isinstance(divisor, ast.Call)
        and name_of(divisor) in _ROOTS
        and program.path(divisor.func, function).startswith(("math.", "numpy."))
    ):
        return (ast.unparse(divisor), "ZeroDivisionError")
    match divisor:
        case ast.Call(func=ast.Name(id="len"), args=[one]) if function.field(one) and _empties(
            program, function, function.field(one)
        ):
            return (ast.unparse(one), "ZeroDivisionError")
    return ()


def _empties(program: Program, function: Function, field: str) -> bool:
    """Whether play takes items out of an attribute."""
    return any(
        isinstance(node, ast.Call) and name_of(node) in ("clear", "discard", "pop", "popitem", "popleft", "remove")
        for one in program.play
        for target, node in one.writes
        if one.field(target) == field and program.bound_to(one) == program.bound_to(function)
    )
