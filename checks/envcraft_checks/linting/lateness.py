"""Prizes that fall with time, and cost in the end."""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator

from envcraft_checks.rewards.lines import RewardLines, Unknown, Write
from envcraft_checks.rewards.syntax import constant

from .dependence import guards
from .limits import time_limit
from .program import Function, Program, Suspect, line, name_of
from .reported import reported
from .unpaid import plain


def late_successes(program: Program) -> Iterator[Suspect]:
    """Find a prize for success that depends on the step, and that is negative at the last step before the limit."""
    step = program.method(program.env, "step")
    values = reported(program, step) if step is not None else None
    counted = time_limit(program)
    if step is None or not values or counted is None:
        return
    counter, limit = counted
    told = {ast.unparse(plain(each.value)) for each in values}
    try:
        writes = RewardLines(program).writes(deep=False)
    except Unknown:
        return
    prizes = [write for write in writes if _is_prize(program, write, told)]
    if any(ast.unparse(plain(_tests(program, write)[0][0])) not in told for write in prizes):
        # Where success holds, another test decides.
        return
    soon, late = (_total(program, prizes, counter, number) for number in (1.0, limit - 1))
    if soon is not None and late is not None and late < 0 and late < soon:
        falling, _ = next(_returned(program, write) for write in prizes if write.amount is None)
        words = f"pays {late:g} for success at step {limit - 1:,.0f}, and {soon:g} at the first step"
        # Another end may come before, or cost more.
        yield Suspect(line(falling), words, certain=False)


def _is_prize(program: Program, write: Write, told: set[str]) -> bool:
    """Whether a place adds to the reward where success holds."""
    return any(ast.unparse(plain(test)) in told and holds for test, holds in _tests(program, write))


def _tests(program: Program, write: Write) -> list[tuple[ast.expr, bool]]:
    """The tests around a place, innermost first, and whether they hold there."""
    return list(guards(program, write.statement, write.scope.function))


def _total(program: Program, prizes: list[Write], counter: str, number: float) -> float | None:
    """What all prizes together pay at a step; None if the code does not tell, or if no prize depends on the step."""
    total, depends = 0.0, False
    for write in prizes:
        amount = write.amount
        if amount is None:
            value, function = _returned(program, write)
            at = _AtStep(function, counter, number)
            known = constant(at.visit(copy.deepcopy(value)), write.scope, program)
            if known is None or not at.found:
                return None
            amount, depends = write.sign * known, True
        total += amount
    return total if depends else None


def _returned(program: Program, write: Write) -> tuple[ast.expr, Function]:
    """What a place writes, or what the function returns that it calls."""
    function = write.scope.function
    if isinstance(write.value, ast.Call) and (called := program.called(write.value, function)) is not None:
        values = [node.value for node in called.nodes if isinstance(node, ast.Return)]
        if len(values) == 1 and values[0] is not None:
            return values[0], called
    return write.value, function


class _AtStep(ast.NodeTransformer):
    """Replaces the step counter by a number, and names by what they are bound to.

    Attributes:
        found: whether the counter is part of an expression that was visited.
    """

    def __init__(self, function: Function, counter: str, number: float) -> None:
        self._function = function
        self._counter = counter
        self._number = number
        self._followed: set[str] = set()
        self.found = False

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if self._function.field(node) != self._counter:
            return node
        self.found = True
        return ast.Constant(self._number)

    def visit_Name(self, node: ast.Name) -> ast.expr:
        changed = {name_of(target) for target, _ in self._function.writes} | set(self._function.parameters)
        bound = [value for target, value, _ in self._function.bindings if name_of(target) == node.id != ""]
        # A name is followed once, and then stays as it is.
        if node.id in changed | self._followed or len(bound) != 1 or bound[0] is None:
            return node
        self._followed.add(node.id)
        followed: ast.expr = self.visit(copy.deepcopy(bound[0]))
        return followed
