"""Rewards of the wrong sign: what brings success about costs."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from envcraft_checks.rewards.lines import RewardLines, Unknown, Write
from envcraft_checks.rewards.syntax import constant, summands

from .dependence import guards
from .logic import is_false, names_success
from .program import MUTATORS, Function, Program, Suspect, name_of
from .reported import Reported, reported

_DEPTH = 4
#: Words in names of what is true when an episode is lost.
_LOSSES = frozenset({"crashed", "dead", "died", "failed", "lose", "loss", "lost"})
_UP, _DOWN = (ast.GtE, ast.Gt, ast.Eq), (ast.LtE, ast.Lt, ast.Eq)
_ADDERS = frozenset({"add", "append", "appendleft", "extend", "insert", "update"})
#: How an attribute comes nearer to success: it becomes true, greater or smaller, it gets a part, or it loses one.
_Way = tuple[str, str]


def punished_successes(program: Program) -> Iterator[Suspect]:
    """Find a branch that brings success nearer, and whose rewards are negative numbers."""
    step = program.method(program.env, "step")
    values = reported(program, step) if step is not None else None
    if step is None or not values:
        return
    ways = {way for each in values for way in _ways(program, each.value, each.function, _DEPTH)}
    try:
        writes = RewardLines(program).writes() if ways else []
    except Unknown:
        return
    blocks: dict[tuple[_Way, int], list[Write]] = {}
    for function in program.reached("step"):
        for node in function.nodes:
            way = next((one for one in _changes(node, function) if one in ways), None)
            # What each step changes is time.
            if isinstance(node, ast.stmt) and way and (block := program.block(node)) is not step.node.body:
                blocks[way, id(block)] = [write for write in writes if write.statement in block]
    for way in ways:
        paid = [found for (one, _), found in blocks.items() if one == way]
        sums = [sum(_constant_part(write, program) for write in found) for found in paid]
        known = all(found and all(_is_known(write, program) for write in found) for found in paid)
        # Where the rest is calculated, a loss that pays shows that the sign is wrong.
        known = known or (way[1] == "true" and all(paid) and _pays_losing(program, writes))
        if paid and known and max(sums) < 0:
            first = paid[0][0]
            # Where success itself pays, this may be its price.
            certain = not any(_is_prize(program, write, values) for write in writes)
            yield Suspect(first.line, f"pays {sums[0]:g} where self.{way[0]} brings success nearer", certain)


def _is_known(write: Write, program: Program) -> bool:
    """Whether what a place adds to the reward is a number, or what the step has earned before its block."""
    function, block = write.scope.function, program.block(write.statement)
    for term, _ in summands(write.value) if write.amount is None else ():
        bound = [statement for target, _, statement in function.bindings if name_of(target) == name_of(term)]
        changed = any(name_of(target) == name_of(term) for target, _ in function.writes)
        earlier = isinstance(term, ast.Name) and bound and not changed and not any(each in block for each in bound)
        if constant(term, write.scope, program) is None and not earlier:
            return False
    return True


def _constant_part(write: Write, program: Program) -> float:
    """What a place adds to the reward, without the terms that are no numbers."""
    if write.amount is not None:
        return write.amount
    amounts = ((constant(term, write.scope, program), way) for term, way in summands(write.value))
    return write.sign * sum(amount * way for amount, way in amounts if amount is not None)


def _pays_losing(program: Program, writes: list[Write]) -> bool:
    """Whether a reward is raised where an attribute that stands for losing becomes true."""
    return any(
        _constant_part(write, program) > 0 and any(_is_loss(each) for each in program.block(write.statement))
        for write in writes
    )


def _is_loss(statement: ast.stmt) -> bool:
    match statement:
        case ast.Assign(targets=[ast.Name() | ast.Attribute() as target], value=ast.Constant(value=True)):
            return not _LOSSES.isdisjoint(name_of(target).lower().split("_"))
    return False


def _is_prize(program: Program, write: Write, values: list[Reported]) -> bool:
    """Whether success decides about a part of the reward that is not known to be negative."""
    tests = [test for test, _ in guards(program, write.statement, write.scope.function)]
    texts = {ast.unparse(each.value) for each in values}
    named = any(
        ast.unparse(node) in texts or (isinstance(node, ast.Name | ast.Attribute) and names_success(name_of(node)))
        for part in [write.value, *tests]
        for node in ast.walk(part)
        if isinstance(node, ast.expr)
    )
    return named and not (write.amount is not None and write.amount < 0)


def _ways(program: Program, node: ast.expr, function: Function, depth: int) -> Iterator[_Way]:
    """The changes of attributes that bring an expression nearer to being true."""
    match node:
        case ast.Call(func=ast.Name(id="bool" | "int"), args=[inner]):
            yield from _ways(program, inner, function, depth)
        case ast.BoolOp(op=ast.And(), values=values):
            for value in values:
                yield from _ways(program, value, function, depth)
        case ast.UnaryOp(op=ast.Not(), operand=operand) if field := function.field(operand):
            yield field, "-part"
        case ast.Call(func=ast.Name(id="all"), args=[inner]) if field := function.field(inner):
            yield field, "item"
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            yield from _compared(left, op, right, function)
        case ast.Name() | ast.Attribute() if depth:
            field = function.field(node)
            if field:
                yield field, "true"
            for bound, owner in program.values(node, function):
                if bound is not None and owner is not None and not is_false(bound):
                    yield from _ways(program, bound, owner, depth - 1)


def _compared(left: ast.expr, op: ast.cmpop, right: ast.expr, function: Function) -> Iterator[_Way]:
    match left:
        case ast.Call(func=ast.Name(id="len"), args=[inner]) if field := function.field(inner):
            empty = isinstance(right, ast.Constant) and right.value == 0
            yield field, "-part" if empty else "+part" if isinstance(op, _UP) else ""
        case ast.Call(func=ast.Name(id="sum"), args=[inner]) if field := function.field(inner):
            yield field, "item"
        case ast.Attribute() if field := function.field(left):
            if isinstance(right, ast.Constant) and right.value == 0 and isinstance(op, _DOWN):
                yield field, "-"
            elif isinstance(op, _UP):
                yield field, "+"


def _changes(statement: ast.AST, function: Function) -> Iterator[_Way]:
    """The changes of attributes that a statement itself makes."""
    match statement:
        case ast.AugAssign(target=target, op=ast.Add(), value=ast.Constant()) if field := function.field(target):
            yield field, "+"
        case ast.AugAssign(target=target, op=ast.Sub(), value=ast.Constant()) if field := function.field(target):
            yield field, "-"
        case ast.Assign(targets=[target], value=ast.Constant(value=True)):
            if field := function.field(target):
                yield field, "true"
            elif isinstance(target, ast.Subscript) and (field := function.field(target.value)):
                yield field, "item"
        case ast.Expr(value=ast.Call(func=ast.Attribute(value=held, attr=attr))) if field := function.field(held):
            if attr in MUTATORS:
                yield field, "+part" if attr in _ADDERS else "-part"
