"""Tables that have fewer items than a level may reach."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import NamedTuple

from .program import Function, Program, Suspect, bindings, catches, line, name_of
from .ranges import Ranges
from .running_out import fixed_length

#: Calls that leave a level as it is, or limit it.
_PLAIN = frozenset({"float", "int", "len", "max", "min", "range", "str"})
#: A price so many times another one is a sign that nobody can pay it.
_UNPAYABLE = 100


class _Level(NamedTuple):
    """An attribute that grows by one behind tests.

    Attributes:
        owner: the name of the object that has it.
        most: the highest number that it reaches.
        tests: the tests.
    """

    owner: str
    most: int
    tests: frozenset[ast.AST]


def outgrown_tables(program: Program) -> Iterator[Suspect]:
    """Find ``REACH[tower.level]`` of three items where ``tower.level < len(COSTS)`` lets the level reach three."""
    names = {name_of(node.target) for node in program.nodes if isinstance(node, ast.AugAssign) and _is_increment(node)}
    for name in sorted(names):
        if (level := _level(program, name)) is None:
            continue
        for function in program.play:
            for node in function.nodes:
                match node:
                    case ast.Subscript(value=table, slice=ast.Attribute(value=owner, attr=attr), ctx=ast.Load()) if (
                        attr == name and name_of(owner) == level.owner
                    ):
                        length = fixed_length(program, table, function)
                        if (
                            length is not None
                            and length <= level.most
                            and not _is_tested(program, node, function, level)
                        ):
                            words = (
                                f"reads {ast.unparse(node)[:40]}, but {ast.unparse(node.slice)} reaches {level.most}"
                            )
                            yield Suspect(line(node), f"{words} and the last item is number {length - 1}")


def _is_increment(node: ast.AST) -> bool:
    match node:
        case ast.AugAssign(target=ast.Attribute(), op=ast.Add(), value=ast.Constant(value=1)):
            return True
    return False


def _is_tested(program: Program, node: ast.AST, function: Function, level: _Level) -> bool:
    """Whether a table is read only where one of the tests holds, or in a method that is called there."""
    places = [(node, function)]
    places += [
        (call, one) for one in program.play for call in one.nodes if name_of(call) == function.name and call is not node
    ]
    return any(
        test in level.tests
        for place, one in places
        for outer in program.around(place, one)
        if isinstance(outer, ast.If | ast.IfExp | ast.BoolOp)
        for test in ast.walk(outer)
    )


def _level(program: Program, name: str) -> _Level | None:
    """What is known of an attribute that steps of one increase, each behind a test of it.

    Nothing else may depend on the attribute, because the episode may end at the highest level, and nothing beside a
    step may keep a table from being read. No error of an index may be caught.
    """
    handlers = (node for one in program.play for node in one.nodes if isinstance(node, ast.ExceptHandler))
    suppressed = any(name_of(node) == "suppress" for node in program.nodes)
    if suppressed or any(catches(handler, "IndexError", "LookupError") for handler in handlers):
        return None
    ranges = Ranges(program)
    given = {target: value for target, value, _ in bindings(program.nodes)}
    increments: set[ast.AST] = set()
    owners, numbers = set(), set()
    tests: set[ast.AST] = set()
    for function in program.play:
        for node in function.nodes:
            match node:
                case ast.AugAssign(target=ast.Attribute(value=owner, attr=attr)) if attr == name and _is_increment(
                    node
                ):
                    guard = _guard(program, ranges, function, node)
                    if guard is None or not _is_bought(program, node, function):
                        return None
                    increments.add(node)
                    owners.add(name_of(owner))
                    tests.add(guard[0])
                    numbers.add(guard[1])
    for node in program.nodes:
        if not isinstance(node, ast.Attribute) or node.attr != name:
            continue
        if isinstance(node.ctx, ast.Load):
            if _decides(program, node, tests):
                return None
        elif program.parents[node] not in increments and not _is_start(given.get(node)):
            return None
    declaring = [owner for owner in program.classes if _declares(program, owner, name)]
    if len(numbers) != 1 or len(owners) != 1 or len(declaring) != 1:
        return None
    return _Level(owners.pop(), numbers.pop(), frozenset(tests))


def _is_start(value: ast.expr | None) -> bool:
    return isinstance(value, ast.Constant) and isinstance(value.value, int)


def _decides(program: Program, node: ast.AST, tests: set[ast.AST]) -> bool:
    """Whether more than those tests may depend on an attribute, apart from numbers that a table has for it."""
    while not isinstance(node, ast.stmt):
        child, node = node, program.parents[node]
        match node:
            case ast.Slice() | ast.FormattedValue():
                return False
            case ast.Subscript(slice=index, value=table) if index is child:
                return not _has_numbers(program, table)
            case ast.Compare() | ast.IfExp() | ast.comprehension() | ast.BoolOp():
                return node not in tests
            case ast.Call() if name_of(node) not in _PLAIN:
                return True
    match node:
        case ast.Assign(targets=targets):
            names = {name_of(one) for target in targets for one in ast.walk(target)}
            return any(isinstance(one, ast.Attribute) for one in targets) or _tests_any(program, node, names)
    return isinstance(node, ast.AnnAssign | ast.If | ast.While | ast.Assert | ast.Return | ast.Match)


def _tests_any(program: Program, statement: ast.stmt, names: set[str]) -> bool:
    """Whether a test of the function in which a statement stands reads one of these names."""
    function: ast.AST = statement
    while not isinstance(function, ast.FunctionDef | ast.Module):
        function = program.parents[function]
    for node in ast.walk(function):
        match node:
            case ast.If(test=test) | ast.IfExp(test=test) | ast.While(test=test) | ast.Assert(test=test):
                pass
            case ast.Match(subject=test) | (ast.Compare() | ast.BoolOp() as test):
                pass
            case _:
                continue
        if any(isinstance(one, ast.Name) and one.id in names for one in ast.walk(test)):
            return True
    return False


def _has_numbers(program: Program, table: ast.expr) -> bool:
    """Whether each item of a table that is written out is a number, or a tuple of numbers such as a colour."""
    items = _written(program, table)
    parts = [part for item in items for part in (item.elts if isinstance(item, ast.Tuple) else [item])]
    return bool(parts) and all(
        isinstance(part, ast.Constant) and isinstance(part.value, int | float) and not isinstance(part.value, bool)
        for part in parts
    )


def _declares(program: Program, owner: str, name: str) -> bool:
    """Whether the body of a class or one of its methods gives it an attribute of this name."""
    body = program.classes[owner].body
    fields = (node.target for node in body if isinstance(node, ast.AnnAssign))
    methods = (node.name for node in body if isinstance(node, ast.FunctionDef))
    own = name in program.class_values(owner) or name in program.field_values(owner) or name in methods
    return own or any(isinstance(field, ast.Name) and field.id == name for field in fields)


def _is_bought(program: Program, increment: ast.AugAssign, function: Function) -> bool:
    """Whether the blocks around an increment pay for it: they subtract from each other attribute that the tests around
    them read, and change no other attribute.

    A test of what nothing takes away, such as a time, may hold too seldom for the highest level.
    """
    tested, paid, other = set(), set(), set()
    child: ast.AST = increment
    for outer in program.around(increment, function):
        if isinstance(outer, ast.If) and child in outer.body:
            tested |= {ast.unparse(node) for node in _outside_tables(outer.test)}
            for node in (part for statement in outer.body for part in ast.walk(statement)):
                match node:
                    case ast.AugAssign(target=ast.Attribute() as target, op=ast.Sub()):
                        paid.add(ast.unparse(target))
                    case ast.Attribute(ctx=ast.Store() | ast.Del()) if node is not increment.target:
                        other.add(ast.unparse(node))
                    case ast.Expr(value=ast.Call()) | ast.Delete():
                        return False
        child = outer
    return tested - {ast.unparse(increment.target)} <= paid and other <= paid


def _outside_tables(test: ast.expr) -> Iterator[ast.Attribute]:
    """The attributes that a test reads, apart from tables and what they are read by."""
    waiting: list[ast.AST] = [test]
    while waiting:
        match waiting.pop():
            case ast.Attribute() as node:
                yield node
            case ast.Subscript() | ast.Call(func=ast.Name(id="len")):
                pass
            case node:
                waiting += ast.iter_child_nodes(node)


def _guard(
    program: Program, ranges: Ranges, function: Function, increment: ast.AugAssign
) -> tuple[ast.Compare, int] | None:
    """The test that must hold for an increment, and the number that the attribute reaches behind it."""
    place = ast.unparse(increment.target)
    child: ast.AST = increment
    for outer in program.around(increment, function):
        if isinstance(outer, ast.If) and child in outer.body:
            all_hold = isinstance(outer.test, ast.BoolOp) and isinstance(outer.test.op, ast.And)
            for part in outer.test.values if isinstance(outer.test, ast.BoolOp) and all_hold else [outer.test]:
                match part:
                    case (
                        ast.Compare(left=left, ops=[ast.Lt() | ast.LtE() as op], comparators=[limit])
                        | ast.Compare(left=limit, ops=[ast.Gt() | ast.GtE() as op], comparators=[left])
                    ) if ast.unparse(left) == place:
                        bound = _bound(program, ranges, limit, function)
                        return None if bound is None else (part, bound + isinstance(op, ast.LtE | ast.GtE))
        child = outer
    return None


def _bound(program: Program, ranges: Ranges, limit: ast.expr, function: Function) -> int | None:
    """The value of a number, of the length of a table, or of that length less a number."""
    match limit:
        case ast.Call(func=ast.Name(id="len"), args=[table]):
            return fixed_length(program, table, function) if _is_payable(program, table) else None
        case ast.BinOp(left=left, op=ast.Sub(), right=ast.Constant(value=int() as less)):
            whole = _bound(program, ranges, left, function)
            return None if whole is None else whole - less
    number = ranges.constant(limit, function)
    return int(number) if number is not None and number == int(number) else None


def _is_payable(program: Program, table: ast.expr) -> bool:
    """Whether the items of a table are numbers of a similar size, so that none of them stands for "never"."""
    items = _written(program, table)
    numbers = [item.value for item in items if isinstance(item, ast.Constant) and isinstance(item.value, int | float)]
    high, low = max(numbers, default=0), min((number for number in numbers if number > 0), default=1)
    return len(numbers) == len(items) > 0 and high <= _UNPAYABLE * low


def _written(program: Program, table: ast.expr) -> list[ast.expr]:
    """The items of a table that the module or the class of the environment writes out."""
    name = name_of(table)
    _, owned = program.class_values(program.env).get(name, ("", None))
    value = owned or program.module_values.get(name)
    return value.elts if isinstance(value, ast.Tuple | ast.List) else []
