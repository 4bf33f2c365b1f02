"""Sets of drawn places, of which two may be the same, where success needs them all."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of

_DRAWS = frozenset({"choice", "integers", "randint", "randrange"})


def colliding_places(program: Program) -> Iterator[Suspect]:
    """Find ``{draw() for _ in range(GEMS)}`` where play compares a count with ``GEMS``: two draws may be equal."""
    stepping = program.reached("step")
    tests = [test for one in stepping for test in one.nodes if isinstance(test, ast.Compare)]
    for function in program.reached("reset"):
        if program.bound_to(function) != program.env or function in stepping:
            continue
        for field, number, node in _drawn(function):
            needs = next((test for test in tests if _needs(test, number)), None)
            if needs is not None and _consumed(stepping, field) and not _refilled(program, stepping, field):
                words = f"draws {number} places into the set self.{field}, where two may be the same, and line"
                yield Suspect(line(node), f"{words} {line(needs)} needs {ast.unparse(needs)[:40]}")


def _drawn(function: Function) -> Iterator[tuple[str, str, ast.AST]]:
    """The sets that a method draws places into: the attribute, their number in the words of the code, and where."""
    for target, value, node in function.bindings:
        match value:
            case (
                ast.SetComp(elt=drawn, generators=[ast.comprehension(target=turn, iter=loop, ifs=[])])
                | ast.Call(
                    func=ast.Name(id="set"),
                    args=[
                        ast.ListComp(elt=drawn, generators=[ast.comprehension(target=turn, iter=loop, ifs=[])])
                        | ast.GeneratorExp(elt=drawn, generators=[ast.comprehension(target=turn, iter=loop, ifs=[])])
                    ],
                )
            ) if (field := function.field(target)) and (number := _number(loop, turn, drawn)):
                yield field, number, node
    for node in function.nodes:
        match node:
            case ast.For(
                target=turn,
                iter=loop,
                body=[ast.Expr(value=ast.Call(func=ast.Attribute(attr="add", value=owner), args=[drawn]))],
            ) if (field := function.field(owner)) and (number := _number(loop, turn, drawn)):
                yield field, number, node


def _number(loop: ast.expr, turn: ast.expr, drawn: ast.expr) -> str:
    """The name of the number of turns of a loop, if each draws a place of its own; "" for another loop."""
    match loop:
        case ast.Call(func=ast.Name(id="range"), args=[ast.Name() | ast.Attribute() as number]):
            turns = {one.id for one in ast.walk(turn) if isinstance(one, ast.Name)}
            names = {one.id for one in ast.walk(drawn) if isinstance(one, ast.Name)}
            calls = {name_of(one) for one in ast.walk(drawn) if isinstance(one, ast.Call)}
            return ast.unparse(number) if calls & _DRAWS and "pop" not in calls and not turns & names else ""
    return ""


def _consumed(stepping: list[Function], field: str) -> bool:
    """Whether a step takes places out of a set."""
    return any(
        one.field(target) == field and isinstance(node, ast.Call) and name_of(node) in ("discard", "pop", "remove")
        for one in stepping
        for target, node in one.writes
    )


def _refilled(program: Program, stepping: list[Function], field: str) -> bool:
    """Whether play may put more places into a set: a step, or a method that looks at its size."""
    for one in program.play:
        for node in one.nodes:
            match node:
                case ast.Call(func=ast.Name(id="len"), args=[counted]) if one.field(counted) == field:
                    return True
    return any(
        one.field(target) == field and (not isinstance(node, ast.Call) or name_of(node) in ("add", "update"))
        for one in stepping
        for target, node in one.writes
    ) or any(one.field(target) == field for one in stepping for target, _, _ in one.bindings)


def _needs(test: ast.Compare, number: str) -> bool:
    """Whether a test asks whether a count has reached a number."""
    match test:
        case ast.Compare(left=left, ops=[ast.GtE() | ast.Eq()], comparators=[right]):
            return ast.unparse(right) == number and not isinstance(left, ast.Constant)
    return False
