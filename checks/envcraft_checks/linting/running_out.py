"""Lists of a fixed length that a counter reads, which nothing keeps below that length."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from typing import NamedTuple

from .program import READERS, Function, Program, Suspect, caught, line, name_of
from .ranges import Ranges

_LIMITS = frozenset({"clip", "max", "maximum", "min", "minimum"})


class _Counter(NamedTuple):
    """A number that only grows: its highest start, and how often an episode may add to it."""

    start: int
    events: float


def short_lists(program: Program) -> Iterator[Suspect]:
    """Find an item that play reads by a counter which only grows and which no test looks at."""
    counters: dict[str, _Counter | None] = {}
    for function in program.reached("step"):
        if program.bound_to(function) != program.env:
            continue
        for node in function.nodes:
            if not isinstance(node, ast.Subscript) or not isinstance(node.ctx, ast.Load):
                continue
            field = function.field(node.slice)
            if not field or (length := fixed_length(program, node.value, function)) is None:
                continue
            if field not in counters:
                counters[field] = _counter(program, field)
            counter = counters[field]
            if (
                counter is None
                or counter.events < length - counter.start
                or caught(program, node, function, "IndexError", "LookupError")
            ):
                continue
            words = f"reads {ast.unparse(node)[:40]}, which has {length} items, and nothing limits self.{field}"
            yield Suspect(line(node), words, certain=False)


def fixed_length(program: Program, node: ast.expr, function: Function) -> int | None:
    """The number of items of a list or a tuple that is written out and never gets another; None if it is not known."""
    field = function.field(node)
    if not field and not isinstance(node, ast.Name):
        return None
    values = [value for value, _ in program.values(node, function)]
    lengths = [
        len(value.elts)
        for value in values
        if isinstance(value, ast.List | ast.Tuple) and not any(isinstance(item, ast.Starred) for item in value.elts)
    ]
    name = field or name_of(node)
    grown = any(
        name_of(node) == name and not _keeps_length(program, node)
        for node in program.nodes
        if isinstance(node, ast.Name | ast.Attribute)
    )
    grown |= any(isinstance(node, ast.Global) and name in node.names for node in program.nodes)
    return max(lengths) if lengths and len(lengths) == len(values) and not grown else None


def _keeps_length(program: Program, node: ast.AST) -> bool:
    """Whether a use of a list reads it, assigns it or changes one item."""
    match program.parents[node]:
        case ast.Subscript(value=value, slice=index, ctx=context) if value is node:
            return isinstance(context, ast.Load) or not isinstance(index, ast.Slice)
        case ast.Call(func=func):
            return func is not node and name_of(func) in READERS
        case ast.For() | ast.comprehension() | ast.Compare() | ast.Assign() | ast.AnnAssign() | ast.Tuple():
            return True
        case ast.Subscript():
            return True
    return False


def _counter(program: Program, field: str) -> _Counter | None:
    """The number to which steps add, if it starts anew in reset() alone, and nothing else depends on it."""
    steps = program.reached("step")
    if any(function.name == "reset" for function in steps):
        return None
    given = {target: value for function in program.all for target, value, _ in function.bindings}
    starts, events = [0], [0.0]
    for node in program.nodes:
        if not isinstance(node, ast.Attribute) or node.attr != field:
            continue
        parent, value = program.parents[node], given.get(node)
        function = next((function for function in steps if node in function.nodes), None)
        match parent:
            case ast.AugAssign(op=ast.Add(), value=ast.Constant(value=int() as amount)) if amount > 0:
                if function is not None:
                    events.append(_events(program, parent, function))
            case _ if isinstance(node.ctx, ast.Store):
                if function is not None or not isinstance(value, ast.Constant) or not isinstance(value.value, int):
                    return None
                starts.append(value.value)
            case _ if not _is_read_only(program, node):
                return None
    return _Counter(max(starts), max(events))


def _events(program: Program, statement: ast.AugAssign, function: Function) -> float:
    """How often a statement runs in an episode at most, as far as the other counts beside it say."""
    ranges = Ranges(program)
    most = math.inf
    for beside in program.block(statement):
        if not isinstance(beside, ast.AugAssign) or beside is statement or not (name := function.field(beside.target)):
            continue
        amount = ranges.constant(beside.value, function)
        values = [ranges.constant(value, one) for value, one in program.field_values(program.env).get(name, ())]
        for limit in _limits(program, ranges, name):
            if not amount or limit is None or None in values or not values:
                # How far the count goes is not known.
                return 0.0
            starts = [abs(limit - value) for value in values if value is not None]
            most = min(most, math.ceil(max(starts) / abs(amount)))
    return most


def _limits(program: Program, ranges: Ranges, field: str) -> Iterator[float | None]:
    """The numbers with which steps compare an attribute; None for one that is not known."""
    for function in program.reached("step"):
        for node in function.nodes:
            if isinstance(node, ast.Compare):
                sides = [node.left, *node.comparators]
                if any(function.field(side) == field for side in sides):
                    yield from (ranges.constant(side, function) for side in sides if function.field(side) != field)


def _is_read_only(program: Program, node: ast.AST) -> bool:
    """Whether an expression is only an index, or part of what is shown: no test and no other number depends on it."""
    child, parent = node, program.parents[node]
    while True:
        match parent:
            case ast.Subscript(slice=index) if index is child:
                return True
            case ast.FormattedValue() | ast.Dict():
                return True
            case ast.Call() if name_of(parent) in ("int", "float", "str"):
                child, parent = parent, program.parents[parent]
            case _:
                return False
