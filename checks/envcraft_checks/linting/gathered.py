"""What the code says of things to gather: whether success needs all of them, and whether only walls stop the player."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .logic import names_success
from .program import Function, Program, name_of
from .ranges import Ranges

_DEPTH = 4
_REMOVING = frozenset({"discard", "pop", "remove"})


def needs_all(program: Program, things: str, placed: int) -> bool:
    """Whether success needs all things of a list: it tests for an empty list, or for a count of as many."""
    ranges = Ranges(program)
    counts: set[str] = set()
    for function in program.reached("step"):
        for node in function.nodes:
            if isinstance(node, ast.AugAssign) and isinstance(node.value, ast.Constant) and node.value.value == 1:
                beside = [part for statement in program.block(node) for part in ast.walk(statement)]
                if any(_removes(part, function, things) for part in beside):
                    counts.add(function.field(node.target))
    for function in program.reached("step"):
        for node in function.nodes:
            match node:
                case ast.UnaryOp(op=ast.Not(), operand=tested):
                    needed = function.field(tested) == things
                case ast.Compare(left=ast.Call(func=ast.Name(id="len"), args=[tested]), ops=[ast.Eq()]):
                    needed = function.field(tested) == things and ranges.constant(node.comparators[0], function) == 0
                case ast.Compare(left=tested, ops=[ast.GtE() | ast.Eq()], comparators=[right]):
                    needed = function.field(tested) in counts - {""} and ranges.constant(right, function) == placed
                case _:
                    continue
            if needed and _wins(program, node):
                return True
    return False


def only_walks(program: Program, player: set[str], grid: str, things: str) -> bool:
    """Whether the player only comes to where the grid lets it, the grid stays, and things go only where the player is.

    Args:
        program: the file.
        player: the attributes that are its cell.
        grid: the attribute with the cells.
        things: the attribute with the cells of the things.
    """
    fresh = program.reached("reset")
    starts = {
        ast.unparse(value)
        for one in fresh
        for target, value, _ in one.bindings
        if value and one.field(target) in player
    }
    for function in program.reached("step"):
        made = {function.field(target) for target, _, _ in function.bindings}
        changes = [*((target, node) for target, _, node in function.bindings), *function.writes]
        for target, node in changes:
            field = function.field(target)
            if field == grid and (function not in fresh or grid not in made):
                return False
            if not field and isinstance(node, ast.Assign) and _holds(node.value, function, grid):
                return False
            if function in fresh:
                continue
            value = ast.unparse(node.value) if isinstance(node, ast.Assign) else ""
            moves = field in player and value not in starts
            if moves and (_wraps(program, function) or not _lets(program, node, function, grid, player)):
                return False
            if field == things and not _attributes(program, node, function, _DEPTH) <= player | {things}:
                return False
    return True


def _wraps(program: Program, function: Function) -> bool:
    """Whether a function computes a remainder otherwise than in a comparison: a way may lead over an edge."""
    for node in function.nodes:
        if isinstance(node, ast.Mod):
            inner = program.parents[node]
            if not isinstance(program.parents[inner], ast.Compare):
                return True
    return any(
        isinstance(node, ast.Call) and name_of(node) in ("divmod", "mod", "remainder") for node in function.nodes
    )


def _removes(node: ast.AST, function: Function, things: str) -> bool:
    """Whether a call removes an item of an attribute."""
    match node:
        case ast.Call(func=ast.Attribute(value=value, attr=attr)):
            return attr in _REMOVING and function.field(value) == things
    return False


def _holds(value: ast.expr, function: Function, grid: str) -> bool:
    """Whether a value contains the grid, and not only an item of it."""
    read = {node for node in ast.walk(value) if function.field(node) == grid}
    items = {node.value for node in ast.walk(value) if isinstance(node, ast.Subscript)}
    return bool(read - items)


def _lets(program: Program, node: ast.AST, function: Function, grid: str, player: set[str]) -> bool:
    """Whether a statement runs only after a test of the grid, and such tests read nothing else that may change."""
    read = [_attributes(program, test, function, _DEPTH) for test in _tests(program, node, function)]
    about = [attributes for attributes in read if grid in attributes]
    return bool(about) and all(attributes <= player | {grid, "np_random"} for attributes in about)


def _tests(program: Program, node: ast.AST, function: Function) -> Iterator[ast.expr]:
    """The tests around a statement, and those before it after which a block ends."""
    inner = node
    for outer in [node, *program.around(node, function)]:
        if isinstance(outer, ast.If) and inner is not outer:
            yield outer.test
        if isinstance(outer, ast.stmt):
            for before in program.block(outer):
                if before is outer:
                    break
                if isinstance(before, ast.If) and isinstance(before.body[-1], ast.Return | ast.Continue | ast.Break):
                    yield before.test
        inner = outer


def _attributes(program: Program, node: ast.AST, function: Function, depth: int) -> set[str]:
    """The attributes of ``self`` that a node reads, by names and by functions that it calls, too."""
    found: set[str] = set()
    for part in ast.walk(node):
        called = program.called(part, function) if isinstance(part, ast.Call) else None
        if called is not None and depth:
            for statement in called.node.body:
                found |= _attributes(program, statement, called, depth - 1)
        elif (field := function.field(part)) and program.method(program.env, field) is None:
            found.add(field)
        elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Load) and part.id in function.local and depth:
            for source in _sources(part.id, function):
                found |= _attributes(program, source, function, depth - 1)
    return found


def _sources(name: str, function: Function) -> Iterator[ast.AST]:
    """What a local name gets its values from: the whole of it if a statement binds several names."""
    for target, value, statement in function.bindings:
        if isinstance(target, ast.Name) and target.id == name:
            yield value or getattr(statement, "value", None) or getattr(statement, "iter", None) or target
    for target, statement in function.writes:
        if isinstance(target, ast.Name) and target.id == name and isinstance(statement, ast.AugAssign):
            yield statement.value


def _wins(program: Program, test: ast.AST) -> bool:
    """Whether a test is a condition of what the code calls success, by the names that it decides."""
    node = test
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
        if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.Or):
            return False
    decided = node.body if isinstance(node, ast.If) else [node]
    parts = [part for statement in decided for part in ast.walk(statement)]
    names = {part.value for part in parts if isinstance(part, ast.Constant) and isinstance(part.value, str)}
    names |= {name_of(target) for part in parts if isinstance(part, ast.Assign) for target in part.targets}
    return any(map(names_success, names))
