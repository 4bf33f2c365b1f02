"""Successes that cost, or whose step loses the reward that the code has just computed."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator

from envcraft_checks.rewards.lines import RewardLines, Unknown, Write
from envcraft_checks.rewards.syntax import constant, summands

from .dependence import guards
from .logic import is_false
from .owed import alternatives
from .program import Function, Program, Suspect, line, name_of
from .reported import reported


def unpaid_successes(program: Program) -> Iterator[Suspect]:
    """Find where success costs, and where step() replaces a reward by zero if it reports success."""
    step = program.method(program.env, "step")
    values = reported(program, step) if step is not None else None
    if step is None or not values:
        return
    told = {ast.unparse(plain(each.value)) for each in values}
    shown = told | alternatives(step, [each.value for each in values])
    try:
        writes = RewardLines(program).writes()
    except Unknown:
        return
    prizes = [(write, prize) for write in writes for prize in _prizes(program, write, shown)]
    # The step that succeeds may earn all that is paid for something else.
    most = sum(max(write.amount or 0.0, 0.0) for write in writes if all(write is not one for one, _ in prizes))
    if prizes and all(prize + most < 0 for _, prize in prizes):
        cost, first = max((prize, write.line) for write, prize in prizes)
        yield Suspect(first, f"pays {cost:g} for success")
    for write in writes:
        parent = program.parents[write.value]
        if not write.is_zero or not isinstance(parent, ast.IfExp) or parent.body is not write.value:
            continue
        if ast.unparse(plain(parent.test)) not in told or _plays(program, parent.orelse, write.scope.function):
            continue
        paid = next((one for one in writes if _pays(one, program)), None)
        if paid is not None:
            words = f"pays 0 if {ast.unparse(parent.test)[:40]}, although line {paid.line} has paid in this step"
            yield Suspect(line(parent), words, certain=False)


def _prizes(program: Program, write: Write, told: set[str]) -> Iterator[float]:
    """What a place pays for success alone: more than without it, or less; infinity if that is not a number."""
    known, unknown = [], False
    for term, way in summands(write.value):
        match term:
            case ast.IfExp(test=test, body=body, orelse=orelse) if ast.unparse(plain(test)) in told:
                one, other = constant(body, write.scope, program), constant(orelse, write.scope, program)
                known.append(math.inf if one is None or other is None else write.sign * way * (one - other))
            case ast.Call(func=ast.Name(id="float" | "int"), args=[inner]) if ast.unparse(plain(inner)) in told:
                known.append(float(write.sign * way))
            case _:
                unknown |= _mentions(term, told)
    function = write.scope.function
    tests = [part for test, holds in guards(program, write.statement, function) for part in _true(test, holds)]
    beside = program.block(write.statement) if program.parents[write.statement] is not function.node else []
    if known:
        yield from known
    elif any(ast.unparse(plain(part)) in told for part in tests) or any(_succeeds(each, told) for each in beside):
        yield math.inf if write.amount is None else write.amount
    elif unknown or any(_mentions(part, told) for part in tests):
        yield math.inf


def _true(test: ast.expr, holds: bool) -> Iterator[ast.expr]:
    """The parts of a test that are true where it holds, or where it does not; a choice of parts is one."""
    match test:
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield from _true(operand, not holds)
        case ast.BoolOp(op=op, values=values) if isinstance(op, ast.And) == holds:
            for value in values:
                yield from _true(value, holds)
        case _ if holds or isinstance(test, ast.BoolOp):
            yield test


def _mentions(node: ast.expr, told: set[str]) -> bool:
    return any(ast.unparse(part) in told for part in ast.walk(node) if isinstance(part, ast.expr))


def _succeeds(statement: ast.stmt, told: set[str]) -> bool:
    """Whether a statement makes success true."""
    targets = statement.targets if isinstance(statement, ast.Assign) and not is_false(statement.value) else []
    return any(ast.unparse(target) in told for target in targets)


def plain(node: ast.expr) -> ast.expr:
    """An expression without the calls of bool() around it."""
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
