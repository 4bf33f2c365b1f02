"""Successes whose step loses the reward that the code has just computed."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from envcraft_checks.rewards.lines import RewardLines, Unknown, Write
from envcraft_checks.rewards.syntax import constant, summands

from .program import Function, Program, Suspect, line, name_of
from .reported import reported


def unpaid_successes(program: Program) -> Iterator[Suspect]:
    """Find where step() replaces a reward that may be positive by zero if success is reported."""
    step = program.method(program.env, "step")
    values = reported(program, step) if step is not None else None
    if step is None or not values:
        return
    told = {ast.unparse(_plain(each.value)) for each in values}
    try:
        writes = RewardLines(program).writes()
    except Unknown:
        return
    for write in writes:
        parent = program.parents[write.value]
        if not write.is_zero or not isinstance(parent, ast.IfExp) or parent.body is not write.value:
            continue
        if ast.unparse(_plain(parent.test)) not in told or _plays(program, parent.orelse, write.scope.function):
            continue
        paid = next((one for one in writes if _pays(one, program)), None)
        if paid is not None:
            words = f"pays 0 if {ast.unparse(parent.test)[:40]}, whatever line {paid.line} has paid in this step"
            yield Suspect(line(parent), words, certain=False)


def _plain(node: ast.expr) -> ast.expr:
    while isinstance(node, ast.Call) and name_of(node) in ("bool", "bool_") and len(node.args) == 1:
        node = node.args[0]
    return node


def _plays(program: Program, node: ast.expr, function: Function) -> bool:
    """Whether an expression calls a function of the file, which may play the step: success is one of the last step."""
    calls = (part for part in ast.walk(node) if isinstance(part, ast.Call))
    return any(program.called(call, function) is not None for call in calls)


def _pays(write: Write, program: Program) -> bool:
    """Whether a place adds a positive number to the reward, at least in some cases."""
    if write.amount is not None:
        return write.amount > 0
    for term, way in summands(write.value):
        for part in (term.body, term.orelse) if isinstance(term, ast.IfExp) else (term,):
            number = constant(part, write.scope, program)
            if number is not None and number * way * write.sign > 0:
                return True
    return False
