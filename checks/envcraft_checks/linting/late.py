"""Pictures that step() draws before it moves what they show."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line

_RESULTS = 5


def late_pictures(program: Program) -> Iterator[Suspect]:
    """Find an observation that step() draws before it calls a method which always changes what the picture shows."""
    step = program.method(program.env, "step")
    if step is None:
        return
    returned = {
        ast.unparse(_original(node.value.elts[0]))
        for node in step.nodes
        if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple) and len(node.value.elts) == _RESULTS
    }
    for number, statement in enumerate(step.node.body):
        match statement:
            case ast.Assign(targets=[target], value=ast.Call() as call) if ast.unparse(target) in returned:
                drawing = program.called(call, step)
                later = step.node.body[number + 1 :]
                if drawing is not None and not any(_draws(program, each, drawing, step) for each in later):
                    yield from _moves(program, step, calls_of(program, drawing), statement, later)


def _original(node: ast.expr) -> ast.expr:
    """What an expression is a copy of."""
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr="copy")):
            return value
        case ast.Call(func=ast.Attribute(attr="array" | "copy"), args=[value, *_]):
            return value
    return node


def _draws(program: Program, statement: ast.stmt, drawing: Function, step: Function) -> bool:
    return any(isinstance(node, ast.Call) and program.called(node, step) is drawing for node in ast.walk(statement))


def calls_of(program: Program, function: Function) -> set[Function]:
    """A function and the functions of the file that it may call."""
    found: set[Function] = set()
    waiting = [function]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.add(one)
            called = (program.called(node, one) for node in one.nodes if isinstance(node, ast.Call))
            waiting += [each for each in called if each is not None]
    return found


def _moves(
    program: Program, step: Function, drawing: set[Function], drawn: ast.stmt, later: list[ast.stmt]
) -> Iterator[Suspect]:
    shown = {one.field(node) for one in drawing for node in one.nodes if isinstance(node, ast.Attribute)} - {""}
    for statement in later:
        if not isinstance(statement, ast.Assign | ast.AugAssign | ast.Expr):
            continue
        for node in ast.walk(statement):
            moving = program.called(node, step) if isinstance(node, ast.Call) else None
            if moving is None or moving in drawing:
                continue
            for change in moving.node.body:
                if isinstance(change, ast.AugAssign) and not _counts(change):
                    field = moving.field(change.target)
                    if field in shown:
                        words = f"draws the observation before line {line(change)} changes self.{field}, which it shows"
                        yield Suspect(line(drawn), words)
                        return


def _counts(change: ast.AugAssign) -> bool:
    """Whether a statement counts by one, as a clock does, whose picture may be a step late."""
    return isinstance(change.value, ast.Constant) and change.value.value in (1, 1.0)
