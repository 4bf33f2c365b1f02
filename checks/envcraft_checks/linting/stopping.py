"""Pictures that show nothing new once a flag is set that only reset() clears."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .dependence import guards
from .dtypes import observing
from .logic import is_false
from .owed import alternatives
from .program import Function, Program, Suspect, line, name_of
from .reported import statement_of

_BLANK = frozenset({"zeros", "zeros_like"})
_CASTS = frozenset({"bool", "float", "int", "uint8"})


def stopped_pictures(program: Program) -> Iterator[Suspect]:
    """Find a flag that play sets and never clears, while the episode goes on, and under which the picture stays."""
    flags = dict(_flags(program))
    makers = [one for one in observing(program) if one[0].name != "reset"] if flags else []
    for function, values in makers:
        for value in values:
            for field, words in [*_kept(program, function, value), *_blank(program, function, value)]:
                if field in flags:
                    yield Suspect(line(value), f"{words} once line {line(flags[field])} has set self.{field}")


def _flags(program: Program) -> Iterator[tuple[str, ast.stmt]]:
    """The attributes that play makes true in branches in which the episode goes on, and that only reset() makes false.

    Yields:
        The attribute, and the first statement that makes it true.
    """
    step, play = program.method(program.env, "step"), program.reached("step")
    if step is None or any(function.name == "reset" for function in play):
        return
    over, places = alternatives(step, _returned(step)), list(_ending(program, step))
    read = {function.field(node) for node, function in places}
    deciding = {function for _, function in places} - {step}
    stored = [
        (node.attr, function)
        for function in play
        for node in function.nodes
        if isinstance(node, ast.Attribute) and not isinstance(node.ctx, ast.Load)
    ]
    made: dict[str, list[tuple[ast.stmt, Function]]] = {}
    for function in play:
        for target, value, statement in function.bindings:
            true = isinstance(value, ast.Constant) and value.value is True
            if (field := function.field(target)) and true and isinstance(statement, ast.stmt):
                made.setdefault(field, []).append((statement, function))
    for field, written in made.items():
        only = sum(attr == field for attr, _ in stored) == len(written)
        if only and field not in read and not any(_may_end(program, *place, over, deciding) for place in written):
            yield field, written[0][0]


def _returned(step: Function) -> list[ast.expr]:
    """The flags that step() returns."""
    return [
        flag
        for node in step.nodes
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple)
        for flag in node.value.elts[2:4]
    ]


def _ending(program: Program, step: Function) -> Iterator[tuple[ast.AST, Function]]:
    """What the flags that step() returns are made of, through names and methods, each with its function."""
    waiting: list[tuple[ast.AST, Function]] = [(flag, step) for flag in _returned(step)]
    seen: set[ast.AST] = set()
    while waiting:
        whole, function = waiting.pop()
        for node in ast.walk(whole):
            if node in seen:
                continue
            seen.add(node)
            yield node, function
            if isinstance(node, ast.Call) and (called := program.called(node, function)) is not None:
                waiting += [(statement, called) for statement in called.node.body]
            elif isinstance(node, ast.Name):
                for target, value, statement in function.bindings:
                    if name_of(target) == node.id and value is not None:
                        waiting.append((value, function))
                        waiting += [(test, function) for test, _ in guards(program, statement, function)]


def _may_end(
    program: Program, statement: ast.stmt, function: Function, over: set[str], deciding: set[Function]
) -> bool:
    """Whether the episode may end where a statement runs, or where something calls its function."""
    waiting, seen = [(statement, function)], {function}
    while waiting:
        one, place = waiting.pop()
        if place in deciding or _ends(program, one, place, over):
            return True
        for caller in program.reached("step"):
            for node in caller.nodes:
                if isinstance(node, ast.Call) and program.called(node, caller) is place and caller not in seen:
                    seen.add(caller)
                    waiting.append((statement_of(program, node), caller))
    return False


def _ends(program: Program, statement: ast.stmt, function: Function, over: set[str]) -> bool:
    """Whether the tests around a statement, or what stands beside it in a branch, end the episode."""
    around = [part for test, holds in guards(program, statement, function) for part in _true(test, holds)]
    beside = [] if program.parents[statement] is function.node else program.block(statement)
    called = [
        each
        for part in beside
        for node in ast.walk(part)
        if isinstance(node, ast.Call) and (one := program.called(node, function)) is not None
        for each in one.node.body
    ]
    return (
        any(ast.unparse(part) in over for part in around)
        or any(map(_is_end, beside))
        or any(_sets(each, over) for each in [*beside, *called])
    )


def _true(test: ast.expr, holds: bool) -> Iterator[ast.expr]:
    """The expressions that may be true where a test holds, or where it does not."""
    match test:
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            yield from _true(operand, not holds)
        case ast.BoolOp(values=values):
            for value in values:
                yield from _true(value, holds)
        case _ if holds:
            yield test


def _sets(statement: ast.stmt, over: set[str]) -> bool:
    """Whether a statement makes an expression true that ends the episode."""
    targets = statement.targets if isinstance(statement, ast.Assign) and not is_false(statement.value) else []
    return any(ast.unparse(target) in over for target in targets)


def _is_end(statement: ast.stmt) -> bool:
    """Whether a statement returns flags that are not both false."""
    match statement:
        case ast.Return(value=ast.Tuple(elts=[_, _, terminated, truncated, _])):
            return not (is_false(terminated) and is_false(truncated))
    return False


def _kept(program: Program, function: Function, value: ast.expr) -> Iterator[tuple[str, str]]:
    """The flags without which alone play draws the attribute that an expression returns."""
    inner = value
    if isinstance(inner, ast.Call) and isinstance(inner.func, ast.Attribute) and inner.func.attr == "copy":
        inner = inner.func.value
    field = function.field(inner)
    if not field:
        return
    drawn = [
        (node, one)
        for one in program.reached("step")
        for target, node in [*((target, statement) for target, _, statement in one.bindings), *one.writes]
        if one.field(target) == field
    ]
    needed = [set(_needed(program, node, one, field)) for node, one in drawn]
    for flag in set.intersection(*needed) if needed else ():
        yield flag, f"returns self.{field}, which nothing draws anew"


def _needed(program: Program, node: ast.AST, function: Function, field: str) -> Iterator[str]:
    """The flags that must be false where a node runs, apart from the first picture of an episode."""
    for test, holds in guards(program, node, function):
        parts = [test]
        if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.Or if holds else ast.And):
            parts = [part for part in test.values if not _is_missing(part, function, field)]
            parts = parts if len(parts) == 1 else []
        elif isinstance(test, ast.BoolOp):
            parts = test.values
        for part in parts:
            negated = isinstance(part, ast.UnaryOp) and isinstance(part.op, ast.Not)
            flag = function.field(part.operand if isinstance(part, ast.UnaryOp) and negated else part)
            if flag and negated == holds:
                yield flag


def _is_missing(test: ast.expr, function: Function, field: str) -> bool:
    """Whether a test says that an attribute is None."""
    match test:
        case ast.Compare(left=left, ops=[ast.Is()], comparators=[ast.Constant(value=None)]):
            return function.field(left) == field
    return False


def _blank(program: Program, function: Function, value: ast.expr) -> Iterator[tuple[str, str]]:
    """The flags under which an expression is an array of zeros."""
    words = "returns a blank picture"
    match value:
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            for side in (left, right):
                while isinstance(side, ast.Call) and name_of(side) in _CASTS and len(side.args) == 1:
                    side = side.args[0]
                negated = isinstance(side, ast.UnaryOp) and isinstance(side.op, ast.Not)
                if field := function.field(side.operand if isinstance(side, ast.UnaryOp) and negated else None):
                    yield field, words
        case ast.IfExp(test=test, body=body) if _is_blank(body):
            if field := function.field(test):
                yield field, words
        case ast.Call() if _is_blank(value):
            for test, holds in guards(program, value, function):
                if holds and (field := function.field(test)):
                    yield field, words


def _is_blank(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and name_of(value) in _BLANK
