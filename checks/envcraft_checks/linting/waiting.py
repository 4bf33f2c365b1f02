"""Rewards that an agent earns by waiting, or by holding a button, where success ends the episode and pays less."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import NamedTuple

from envcraft_checks.rewards.lines import RewardLines, Unknown, Write
from envcraft_checks.rewards.syntax import constant, summands

from .actions import Actions
from .dependence import guards
from .limits import step_limit
from .logic import is_false
from .owed import alternatives
from .program import Function, Program, Suspect, line, name_of
from .reported import Reported, reported

#: How many times more than success the whole time must pay: success ends the first half of the episode at the latest.
_TIMES = 2
#: The longest episode whose rewards are added up.
_LONGEST = 100_000
#: What a step may pay by the default contract, which counts where the code does not say what a part of the reward is.
_ALLOWED = 100.0
_DEPTH = 4
_BOOLS = (ast.Compare, ast.BoolOp)
_CASTS = frozenset({"bool", "float", "int"})


class _Paid(NamedTuple):
    """A part of the reward that each step pays: a number, or the text of a part of the action with its most."""

    line: int
    amounts: list[float]
    words: str
    is_chosen: bool


def waiting_pays(program: Program) -> Iterator[Suspect]:
    """Find what each step pays, or each step with a button held, if more than half of it is more than success pays."""
    step, limit = program.method(program.env, "step"), step_limit(program)
    values = reported(program, step) if step is not None else None
    if step is None or not values or limit is None or not 0 < limit <= _LONGEST:
        return
    if not _is_end(program, step, values):
        return
    try:
        writes = RewardLines(program).writes()
    except Unknown:
        return
    reading = _Reading(program, step, int(limit))
    lasts = _comes_with_time(program, step, values)
    paid, most, known = [], 0.0, True
    for write in writes:
        if write.amount is not None and reading.costs(write):
            paid.append(_Paid(line(write.statement), [write.amount] * int(limit), "", False))
            continue
        always = reading.is_always(write)
        for term, way in summands(write.value) if write.amount is None else [(write.value, 1)]:
            part = reading.paid(term, write, write.sign * way) if always else None
            if part is not None:
                paid.append(part)
                continue
            size = reading.most(term, write, write.sign * way)
            known &= size is not None
            most += max(size or 0.0, 0.0)
    most = max(most, 0.0 if known else _ALLOWED)
    if lasts:
        paid = [part for part in paid if part.is_chosen]
    total = sum(sum(part.amounts) for part in paid)
    first = next((part for part in paid if sum(part.amounts) > 0), None)
    if first is not None and total > _TIMES * most:
        words = f"pays {first.words}: {total:g} in {limit:g} steps, while success ends the episode and pays"
        yield Suspect(first.line, f"{words} at most {most:g}" if known else f"{words} what a step may pay")


class _Reading:
    """What the parts of a reward may be, as far as the code says."""

    def __init__(self, program: Program, step: Function, limit: int) -> None:
        self._program, self._step, self._limit = program, step, limit
        self._actions = Actions(program)
        self._clocks, self._called = _clocks(program, step), _called(program, step)
        ends = [node for node in step.nodes if isinstance(node, ast.Return) and not _is_over(node)]
        #: Whether each step that goes on comes to one statement.
        self._single = len(ends) == 1

    def costs(self, write: Write) -> bool:
        """Whether each step may pay a negative amount."""
        function = write.scope.function
        return (write.amount or 0.0) < 0 and function in self._called and write.statement in function.node.body

    def is_always(self, write: Write) -> bool:
        """Whether each step that does not end the episode runs a statement once."""
        return self._single and write.once and write.statement in self._step.node.body

    def paid(self, term: ast.expr, write: Write, sign: int) -> _Paid | None:
        """What a term pays in each step; None if that depends on the state of the game."""
        known = [write.amount] * self._limit if write.amount is not None else []
        if not known:
            numbers = [self._number(term, write, time) for time in range(1, self._limit + 1)]
            known = [sign * number for number in numbers if number is not None]
        if len(known) == self._limit:
            words = f"{known[0]:g} in each step" if known[0] == known[-1] else f"{ast.unparse(term)[:40]} in each step"
            return _Paid(line(write.statement), known, words, False)
        span = self._span(term)
        if span is None or sign < 0:
            return None
        return _Paid(
            line(write.statement), [span] * self._limit, f"{ast.unparse(term)[:40]} for the action itself", True
        )

    def _number(self, term: ast.expr, write: Write, time: int) -> float | None:
        """The value of an expression of constants and of counts of the steps, at one of them."""
        known = constant(term, write.scope, self._program)
        if known is not None:
            return known
        match term:
            case ast.Attribute() if write.scope.function.field(term) in self._clocks:
                return float(time)
            case ast.Call(func=ast.Name(id="float" | "int"), args=[inner], keywords=[]):
                return self._number(inner, write, time)
            case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
                one, other = self._number(left, write, time), self._number(right, write, time)
                if one is None or other is None or (isinstance(op, ast.Div) and not other):
                    return None
                return one * other if isinstance(op, ast.Mult) else one / other
        return None

    def _span(self, term: ast.expr) -> float | None:
        """The most that a term pays which an action alone decides; None for another one, or if it may cost."""
        match term:
            case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]) if name in _CASTS:
                return self._span(inner)
            case ast.BinOp(left=ast.Constant(value=int() | float() as times), op=ast.Mult(), right=inner):
                span = self._span(inner)
                return times * span if span is not None and times > 0 else None
            case ast.Compare() if self._actions.known and self._actions.is_chosen(term, self._step):
                return 1.0
        values = self._actions.of(term, self._step) if self._actions.known else None
        if values is None or isinstance(values, list) or not values.chosen or values.low < 0:
            return None
        return float(values.high)

    def most(self, term: ast.expr, write: Write, sign: int) -> float | None:
        """The most that a term adds to the reward of a step; None if it is not known."""
        if write.amount is not None:
            return write.amount
        known = constant(term, write.scope, self._program)
        if known is not None:
            return sign * known
        match term:
            case ast.IfExp(body=body, orelse=orelse):
                return _largest([self.most(part, write, sign) for part in (body, orelse)])
            case ast.Name(id=name) if not self._is_bool(term, write.scope.function, _DEPTH):
                function = write.scope.function
                values = [value for target, value, _ in function.bindings if name_of(target) == name]
                changed = any(name_of(target) == name for target, _ in function.writes)
                fixed = values and not changed and name not in function.parameters
                return _largest([self.most(value, write, sign) for value in values if value]) if fixed else None
            case ast.BinOp(left=left, op=ast.Mult(), right=right):
                for one, other in ((left, right), (right, left)):
                    times = constant(one, write.scope, self._program)
                    if times is not None and self._is_bool(other, write.scope.function, _DEPTH):
                        return max(sign * times, 0.0)
        return float(sign > 0) if self._is_bool(term, write.scope.function, _DEPTH) else None

    def _is_bool(self, node: ast.expr | None, function: Function, depth: int) -> bool:
        """Whether an expression is True or False, or such a value as a number."""
        match node:
            case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]) if name in _CASTS:
                return name == "bool" or self._is_bool(inner, function, depth)
            case ast.Constant(value=value):
                return isinstance(value, bool)
            case ast.UnaryOp(op=ast.Not()):
                return True
            case ast.Name() | ast.Attribute() if depth:
                values = self._program.values(node, function)
                return bool(values) and all(
                    owner is not None and self._is_bool(value, owner, depth - 1) for value, owner in values
                )
        return isinstance(node, _BOOLS)


def _largest(amounts: list[float | None]) -> float | None:
    known = [amount for amount in amounts if amount is not None]
    return max(known) if known and len(known) == len(amounts) else None


def _is_over(end: ast.Return) -> bool:
    """Whether a return statement ends the episode in any case."""
    flags = end.value.elts[2:4] if isinstance(end.value, ast.Tuple) else []
    return any(isinstance(flag, ast.Constant) and flag.value is True for flag in flags)


def _is_end(program: Program, step: Function, values: list[Reported]) -> bool:
    """Whether each success that info reports ends the episode."""
    flags = [
        flag
        for node in step.nodes
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple)
        for flag in node.value.elts[2:4]
    ]
    over = alternatives(step, flags)
    told = [each for each in values if not is_false(each.value)]
    return bool(told) and all(_ends(program, each, over) for each in told)


def _ends(program: Program, told: Reported, over: set[str]) -> bool:
    if isinstance(told.value, ast.Constant):
        return _is_over(told.end)
    inner = told.value
    while isinstance(inner, ast.Call) and name_of(inner) in ("bool", "bool_") and inner.args:
        inner = inner.args[0]
    return ast.unparse(inner) in over or _ends_beside(program, inner, told.function, over)


def _ends_beside(program: Program, flag: ast.expr, function: Function, over: set[str]) -> bool:
    """Whether a flag of the end becomes true beside each place where an attribute of success does."""
    field = function.field(flag)
    places = [
        statement
        for one in program.reached("step")
        for target, value, statement in one.bindings
        if field and one.field(target) == field and not is_false(value)
    ]
    return bool(places) and all(
        any(
            isinstance(each, ast.Assign)
            and isinstance(each.value, ast.Constant)
            and each.value.value is True
            and any(ast.unparse(target) in over for target in each.targets)
            for each in program.block(place)
        )
        for place in places
    )


def _deciding(program: Program, step: Function, values: list[Reported]) -> Iterator[tuple[ast.expr, Function]]:
    """The comparisons and other expressions of which success is made, and those by which it becomes true."""
    waiting: list[tuple[ast.expr, Function, int]] = [(each.value, each.function, _DEPTH) for each in values]
    waiting += [(test, step, _DEPTH) for each in values for test, _ in guards(program, each.end, step)]
    while waiting:
        node, function, depth = waiting.pop()
        match node:
            case ast.BoolOp(values=parts):
                waiting += [(part, function, depth) for part in parts]
            case ast.UnaryOp(op=ast.Not(), operand=part) | ast.Call(func=ast.Name(id="bool"), args=[part]):
                waiting.append((part, function, depth))
            case _:
                yield node, function
                whole = isinstance(node, ast.Name | ast.Attribute)
                for inner in ast.walk(node):
                    if depth and (isinstance(inner, ast.Name) or (whole and function.field(inner))):
                        waiting += [(*each, depth - 1) for each in _bound(program, inner, function)]


def _bound(program: Program, node: ast.AST, function: Function) -> Iterator[tuple[ast.expr, Function]]:
    """What play binds a name or an attribute to, with the tests around that."""
    field = function.field(node)
    for one in program.reached("step") if field else [function]:
        for target, value, statement in one.bindings:
            same = one.field(target) == field if field else isinstance(target, ast.Name) and target.id == name_of(node)
            if same and value is not None and not is_false(value):
                yield value, one
                yield from ((test, one) for test, _ in guards(program, statement, one))


def _comes_with_time(program: Program, step: Function, values: list[Reported]) -> bool:
    """Whether something that each step changes under any action decides success: then success means to last."""
    clocks = {field for node, field in _steady(program, step) if not any(map(_is_local, ast.walk(node.value)))}
    return any(
        function.field(part) in clocks for node, function in _deciding(program, step, values) for part in ast.walk(node)
    )


def _is_local(node: ast.AST) -> bool:
    return isinstance(node, ast.Name) and node.id != "self" and not node.id.isupper()


def _clocks(program: Program, step: Function) -> set[str]:
    """The attributes that count the steps."""
    found = {field for node, field in _steady(program, step) if isinstance(node.op, ast.Add) and _is_one(node.value)}
    sets = {
        one.field(target)
        for one in program.reached("step")
        for target, _, _ in one.bindings
        if one.field(target) in found
    }
    return found - sets


def _is_one(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value == 1


def _steady(program: Program, step: Function) -> Iterator[tuple[ast.AugAssign, str]]:
    """The statements with which each step adds to an attribute, each with the attribute."""
    for function in _called(program, step):
        for statement in _first(function):
            if isinstance(statement, ast.AugAssign) and (field := function.field(statement.target)):
                yield statement, field


def _called(program: Program, step: Function) -> list[Function]:
    """The functions that each step calls, itself included."""
    found = [step]
    for function in found:
        for statement in _first(function):
            if isinstance(statement, ast.Expr | ast.Assign | ast.AugAssign):
                called = (program.called(node, function) for node in ast.walk(statement) if isinstance(node, ast.Call))
                found += [each for each in called if each is not None and each not in found]
    return found


def _first(function: Function) -> Iterator[ast.stmt]:
    """The statements of a function up to the first that may leave it."""
    for statement in function.node.body:
        yield statement
        if any(isinstance(node, ast.Return | ast.Raise) for node in ast.walk(statement)):
            return
