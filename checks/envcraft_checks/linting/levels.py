"""Tables that have fewer items than a level may reach."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import cast

from .program import Function, Program, Suspect, bindings, caught, line
from .ranges import Ranges
from .running_out import fixed_length


def outgrown_tables(program: Program) -> Iterator[Suspect]:
    """Find ``REACH[tower.level]`` of three items where ``tower.level < len(COSTS)`` lets the level reach three."""
    steps = program.reached("step")
    names = {node.target.attr for one in steps for node in one.nodes if _is_increment(node)}
    for name in sorted(names):
        most, tests = _highest(program, steps, name)
        for function in steps if most else ():
            for node in function.nodes:
                match node:
                    case ast.Subscript(value=table, slice=ast.Attribute(attr=attr), ctx=ast.Load()) if attr == name:
                        length = fixed_length(program, table, function)
                        if length is None or length > most or _is_tested(program, node, function, tests):
                            continue
                        words = f"reads {ast.unparse(node)[:40]}, but {ast.unparse(node.slice)} reaches {most}"
                        yield Suspect(line(node), f"{words} and the last item is number {length - 1}")


def _is_increment(node: ast.AST) -> bool:
    match node:
        case ast.AugAssign(target=ast.Attribute(), op=ast.Add(), value=ast.Constant(value=1)):
            return True
    return False


def _is_tested(program: Program, node: ast.AST, function: Function, tests: set[ast.AST]) -> bool:
    """Whether a table is read only where one of the tests holds, or where an error is caught."""
    around = program.around(node, function)
    return caught(program, node, function, "IndexError", "LookupError") or any(
        test in tests
        for outer in around
        if isinstance(outer, ast.If | ast.IfExp | ast.BoolOp)
        for test in ast.walk(outer)
    )


def _highest(program: Program, steps: list[Function], name: str) -> tuple[int, set[ast.AST]]:
    """The number that an attribute reaches by steps of one, each behind a test of it, and these tests; 0 if that is not
    known.

    Nothing else may test the attribute, because such a test may end the episode there, or keep a table from being read.
    """
    ranges = Ranges(program)
    unknown: tuple[int, set[ast.AST]] = 0, set()
    tests: set[ast.AST] = set()
    highest = []
    for function in steps:
        for node in function.nodes:
            if _is_increment(node) and isinstance(node, ast.AugAssign) and name == getattr(node.target, "attr", ""):
                found = _guard(program, ranges, function, node)
                if found is None:
                    return unknown
                tests.add(found[0])
                highest.append(found[1])
    given = {target: value for target, value, _ in bindings(program.nodes)}
    increments = 0
    for node in program.nodes:
        if not isinstance(node, ast.Attribute) or node.attr != name:
            continue
        parent = program.parents[node]
        if isinstance(node.ctx, ast.Store):
            increments += _is_increment(parent)
            start = given.get(node)
            if not _is_increment(parent) and not (isinstance(start, ast.Constant) and isinstance(start.value, int)):
                return unknown
        elif isinstance(node.ctx, ast.Del) or _decides(program, node, tests):
            return unknown
    owners = {owner for owner in program.classes if _declares(program, owner, name)}
    return (max(highest), tests) if highest and increments == len(highest) and len(owners) == 1 else unknown


def _decides(program: Program, node: ast.AST, tests: set[ast.AST]) -> bool:
    """Whether more than those tests may depend on an attribute."""
    while not isinstance(node, ast.stmt):
        child, node = node, program.parents[node]
        match node:
            case ast.Slice() | ast.FormattedValue():
                return False
            case ast.Subscript(slice=index) if index is child:
                return False
            case ast.Compare() if node not in tests:
                return True
    match node:
        # Tests may look at the other name.
        case ast.Assign(value=ast.Attribute()) | ast.Return():
            return True
    return False


def _declares(program: Program, owner: str, name: str) -> bool:
    """Whether the body of a class or one of its methods gives it an attribute of this name."""
    fields = (node.target for node in program.classes[owner].body if isinstance(node, ast.AnnAssign))
    own = name in program.class_values(owner) or name in program.field_values(owner)
    return own or any(isinstance(field, ast.Name) and field.id == name for field in fields)


def _guard(
    program: Program, ranges: Ranges, function: Function, increment: ast.AugAssign
) -> tuple[ast.Compare, int] | None:
    """The test that must hold for an increment, and the number that the attribute reaches behind it."""
    place, child = ast.unparse(increment.target), cast("ast.AST", increment)
    for outer in program.around(increment, function):
        if isinstance(outer, ast.If) and child in outer.body:
            parts = outer.test.values if isinstance(outer.test, ast.BoolOp) else [outer.test]
            if isinstance(outer.test, ast.BoolOp) and not isinstance(outer.test.op, ast.And):
                parts = []
            for part in parts:
                match part:
                    case ast.Compare(left=left, ops=[ast.Lt() | ast.LtE() as op], comparators=[limit]) if (
                        ast.unparse(left) == place
                    ):
                        bound = _bound(program, ranges, limit, function)
                        return None if bound is None else (part, bound + isinstance(op, ast.LtE))
        child = outer
    return None


def _bound(program: Program, ranges: Ranges, limit: ast.expr, function: Function) -> int | None:
    """The value of a number, of the length of a table, or of that length less a number."""
    match limit:
        case ast.Call(func=ast.Name(id="len"), args=[table]):
            return fixed_length(program, table, function)
        case ast.BinOp(left=left, op=ast.Sub(), right=ast.Constant(value=int() as less)):
            whole = _bound(program, ranges, left, function)
            return None if whole is None else whole - less
    number = ranges.constant(limit, function)
    return int(number) if number is not None and number == int(number) else None
