"""Tests of an action that no action of the space passes."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import NamedTuple

from .program import Function, Program, Suspect, arguments, line, name_of
from .ranges import Ranges


class _Span(NamedTuple):
    """The lowest and the highest value of a number, and whether it may be an action, not only a constant."""

    low: int
    high: int
    chosen: bool = True

    def __str__(self) -> str:
        return f"{self.low} or {self.high}" if self.high == self.low + 1 else f"{self.low} to {self.high}"


#: The values of a number, or those of each number of an array.
_Spans = _Span | list[_Span]

_MIRRORED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Gt: ast.Lt, ast.Lt: ast.Gt, ast.GtE: ast.LtE, ast.LtE: ast.GtE,
}  # fmt: skip
#: Calls whose result equals what they are given, as one number or as an array.
_SAME = frozenset({
    "array", "asarray", "astype", "copy", "flatten", "int", "int16", "int32", "int64", "int8", "intp", "item", "list",
    "ravel", "round", "squeeze", "tolist", "tuple",
})  # fmt: skip


def impossible_actions(program: Program) -> Iterator[Suspect]:
    """Find comparisons of an action, or of a part of it, with a number that its space does not have."""
    actions = Actions(program)
    if not actions.known:
        return
    for function in program.reached("step"):
        for node in function.nodes:
            match node:
                case ast.Compare(left=left, ops=[ast.Eq()], comparators=[right]):
                    for one, other in ((left, right), (right, left)):
                        if span := actions.without(one, [other], function):
                            yield from _never(program, node, node, one, span)
                case ast.Compare(
                    left=left, ops=[ast.Gt() | ast.GtE() | ast.Lt() | ast.LtE() as order], comparators=[right]
                ):
                    for one, other, kind in ((left, right, type(order)), (right, left, _MIRRORED[type(order)])):
                        span = actions.beyond(one, kind, other, function)
                        if span and not _corrects(program, node, one):
                            yield from _never(program, node, node, one, span)
                case ast.Compare(left=left, ops=[ast.In()], comparators=[ast.Tuple() | ast.List() | ast.Set() as some]):
                    if span := actions.without(left, some.elts, function):
                        yield from _never(program, node, node, left, span)
                case ast.Match(subject=subject, cases=cases):
                    for case in cases:
                        if span := actions.without(subject, _values(case.pattern), function):
                            yield from _never(program, case.pattern, case, subject, span)
                case (
                    ast.Subscript(value=table, slice=key)
                    | ast.Call(func=ast.Attribute(attr="get", value=table), args=[key, *_])
                ):
                    if actions.of(key, function) is not None:
                        yield from _keys_twice(program, table, function)


def _corrects(program: Program, test: ast.expr, action: ast.expr) -> bool:
    """Whether a branch only gives an action another value, or does not go on: a guard against what is no action."""
    branch = program.parents[test]
    while isinstance(branch, ast.UnaryOp | ast.BoolOp):
        branch = program.parents[branch]
    if isinstance(branch, ast.Assert):
        return True
    names = {name_of(node) for node in ast.walk(action)}
    return isinstance(branch, ast.If) and all(
        isinstance(each, ast.Return | ast.Continue)
        or (isinstance(each, ast.Assign) and names & {name_of(target) for target in each.targets})
        for each in branch.body
    )


def _never(program: Program, test: ast.AST, branch: ast.AST, action: ast.expr, span: _Span) -> Iterator[Suspect]:
    """Report a test, unless it only rejects what is no action."""
    while isinstance(branch, ast.expr):
        branch = program.parents[branch]
    body = getattr(branch, "body", None)
    if isinstance(body, list) and all(isinstance(one, ast.Raise | ast.Pass) for one in body):
        return
    tests = f"tests {ast.unparse(test)[:60]}" if isinstance(test, ast.expr) else f"has case {ast.unparse(test)[:40]}"
    yield Suspect(line(test), f"{tests}, but {ast.unparse(action)[:40]} is {span} by the action space")


def _values(pattern: ast.pattern) -> list[ast.expr]:
    """The values of a pattern that has nothing else."""
    match pattern:
        case ast.MatchValue(value=value):
            return [value]
        case ast.MatchOr(patterns=patterns):
            values = [_values(one) for one in patterns]
            return [one for each in values for one in each] if all(values) else []
    return []


def _keys_twice(program: Program, table: ast.expr, function: Function) -> Iterator[Suspect]:
    bound = [value for value, _ in program.values(table, function)] or [table]
    for value in bound:
        if not isinstance(value, ast.Dict):
            continue
        seen: dict[str, str] = {}
        for key, item in zip(value.keys, value.values, strict=True):
            if isinstance(key, ast.Constant):
                text, result = ast.unparse(key), ast.unparse(item)
                if seen.setdefault(text, result) != result:
                    yield Suspect(line(key), f"gives the key {text} a second time, which replaces {seen[text][:40]}")


class Actions:
    """The values that an expression has in every play, if it is an action, or a part of one.

    Attributes:
        known: whether the code shows the space.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        self._ranges = Ranges(program)
        self._step = program.method(program.env, "step")
        self._space = self._read_space()
        self._found: dict[tuple[str, Function], _Spans | None] = {}
        self.known = self._space is not None and self._step is not None

    def without(self, node: ast.expr, others: list[ast.expr], function: Function) -> _Span | None:
        """The values of an expression, if it is an action and equals none of some whole numbers."""
        numbers = [self._constant(one, function) for one in others]
        span = self.of(node, function) if numbers else None
        if not isinstance(span, _Span) or not span.chosen:
            return None
        outside = all(one is not None and not span.low <= one <= span.high for one in numbers)
        return span if outside else None

    def beyond(self, node: ast.expr, order: type[ast.cmpop], other: ast.expr, function: Function) -> _Span | None:
        """The values of an expression, if it is an action and no value has this order to a whole number."""
        span, number = self.of(node, function), self._constant(other, function)
        if not isinstance(span, _Span) or not span.chosen or number is None:
            return None
        never = {
            ast.Gt: span.high <= number,
            ast.GtE: span.high < number,
            ast.Lt: span.low >= number,
            ast.LtE: span.low > number,
        }
        return span if never[order] else None

    @property
    def parts(self) -> int:
        """The number of parts of an action; 0 if it has none, or if the code does not show the space."""
        return len(self._space) if isinstance(self._space, list) else 0

    def is_chosen(self, node: ast.expr, function: Function) -> bool:
        """Whether an expression is a part of an action, or compares one with a number."""
        span = self.of(node.left if isinstance(node, ast.Compare) else node, function)
        return isinstance(span, _Span) and span.chosen

    def is_whole(self, node: ast.expr, function: Function) -> bool:
        """Whether an expression is an action with all of its parts."""
        spans = self.of(node, function)
        return isinstance(spans, list) and bool(spans) and spans == self._space

    def place(self, index: ast.expr, function: Function) -> int | None:
        """Which part of an action an index reads; None if the code does not say."""
        place = None if isinstance(index, ast.Slice) else self._constant(index, function)
        return place % self.parts if place is not None and -self.parts <= place < self.parts else None

    def of(self, node: ast.expr, function: Function) -> _Spans | None:
        """The values of an expression; None for one that is no action."""
        match node:
            case ast.Name(id=name):
                return self._named(name, function)
            case ast.Call(func=ast.Name(id="map"), args=[ast.Name(id="int"), one]):
                return self.of(one, function)
            case ast.Call(func=ast.Attribute(value=one)) if name_of(node) in _SAME and not self._is_module(node.func):
                return self.of(one, function)
            case ast.Call(args=[one, *_]) if name_of(node) in _SAME:
                return self.of(one, function)
            case (
                ast.ListComp(elt=elt, generators=[ast.comprehension(target=ast.Name(id=name), iter=one, ifs=[])])
                | ast.GeneratorExp(elt=elt, generators=[ast.comprehension(target=ast.Name(id=name), iter=one, ifs=[])])
            ):
                same = elt.args[0] if isinstance(elt, ast.Call) and name_of(elt) == "int" and elt.args else elt
                return self.of(one, function) if isinstance(same, ast.Name) and same.id == name else None
            case ast.Subscript(value=value, slice=index):
                return self._part(self.of(value, function), index, function)
            case ast.IfExp(body=one, orelse=other):
                return _hull([self.of(one, function), self.of(other, function)])
        number = self._constant(node, function)
        return None if number is None else _Span(number, number, chosen=False)

    def _part(self, spans: _Spans | None, index: ast.expr, function: Function) -> _Spans | None:
        if not isinstance(spans, list) or isinstance(index, ast.Slice):
            return None
        place = self._constant(index, function)
        if place is None:
            return _hull([*spans])
        return spans[place] if -len(spans) <= place < len(spans) else None

    def _is_module(self, node: ast.expr) -> bool:
        return self.program.path(node).startswith(("numpy.", "math."))

    def _named(self, name: str, function: Function) -> _Spans | None:
        key = name, function
        if key not in self._found:
            # While it is looked for, it adds nothing to itself: `action = int(action)` has no other values.
            self._found[key] = []
            self._found[key] = _hull([*self._given(name, function), *self._bound(name, function)])
        return self._found[key]

    def _bound(self, name: str, function: Function) -> Iterator[_Spans | None]:
        """The values of each statement that binds a local name."""
        stores = {
            node
            for node in function.nodes
            if isinstance(node, ast.Name) and node.id == name and not isinstance(node.ctx, ast.Load)
        }
        if any(isinstance(node, ast.arg) and node.arg == name for node in function.nodes):
            yield None
        for target, value, statement in function.bindings:
            if target not in stores:
                continue
            stores.discard(target)
            if value is not None:
                yield self.of(value, function)
                continue
            match statement:
                case ast.Assign(targets=[ast.Tuple(elts=elts) | ast.List(elts=elts)], value=whole) if target in elts:
                    spans = self.of(whole, function)
                    fits = isinstance(spans, list) and (not spans or len(spans) == len(elts))
                    yield (spans[elts.index(target)] if spans else []) if fits and isinstance(spans, list) else None
                case _:
                    yield None
        # Loops, additions and comprehensions bind it to what is not known here.
        yield from [None] * len(stores)

    def _given(self, name: str, function: Function) -> Iterator[_Spans | None]:
        """The values that callers give a parameter."""
        if name not in function.parameters:
            return
        if function is self._step:
            yield self._space if function.parameters.index(name) == 1 else None
            return
        known = set()
        for caller in self.program.all:
            for call in caller.nodes:
                if isinstance(call, ast.Call) and self.program.called(call, caller) is function:
                    known.add(call.func)
                    given = dict(arguments(call, function)).get(name)
                    starred = any(isinstance(one, ast.Starred) for one in call.args)
                    yield None if given is None or starred else self.of(given, caller)
        if any(
            node not in known
            for node in self.program.nodes
            if isinstance(node, ast.Attribute | ast.Name) and name_of(node) == function.name
        ):
            yield None

    def _constant(self, node: ast.expr, function: Function | None) -> int | None:
        match node:
            case ast.Attribute(value=ast.Name(id=owner), attr=attr) if owner in self.program.classes:
                defined = self.program.class_values(owner).get(attr)
                return None if defined is None or defined[1] is None else self._constant(defined[1], None)
        number = self._ranges.constant(node, function)
        return int(number) if number is not None and number == int(number) else None

    def _read_space(self) -> _Spans | None:
        program = self.program
        if any(program.env in program.lineage(one)[1:] for one in program.classes):
            # A class that inherits the code may have more actions.
            return None
        values = program.field_values(program.env).get("action_space", [])
        found: list[tuple[ast.expr | None, Function | None]] = [*values]
        if not found and "action_space" in (defined := program.class_values(program.env)):
            found = [(defined["action_space"][1], None)]
        return self._spans(*found[0]) if len(found) == 1 else None

    def _spans(self, node: ast.expr | None, function: Function | None) -> _Spans | None:
        match node:
            case ast.Call(args=[count], keywords=keywords) if name_of(node) == "Discrete":
                first: int | None = 0
                for keyword in keywords:
                    first = self._constant(keyword.value, function) if keyword.arg == "start" else first
                number = self._constant(count, function)
                return None if number is None or first is None else _Span(first, first + number - 1)
            case ast.Call(args=[counts, *_]) if name_of(node) == "MultiDiscrete" and not _has_start(node):
                if isinstance(counts, ast.Call) and name_of(counts) in ("array", "asarray") and counts.args:
                    counts = counts.args[0]
                numbers = [self._constant(one, function) for one in getattr(counts, "elts", ())]
                spans = [_Span(0, one - 1) for one in numbers if one is not None]
                return spans if spans and len(spans) == len(numbers) else None
            case ast.Call(args=[ast.Constant(value=int(count))]) if name_of(node) == "MultiBinary":
                return [_Span(0, 1)] * count
        return None


def _has_start(call: ast.Call) -> bool:
    return any(keyword.arg == "start" for keyword in call.keywords)


def _hull(parts: list[_Spans | None]) -> _Spans | None:
    """All values of some expressions, of which those that are still looked for are empty."""
    known = [one for one in parts if one != []]
    if None in known or not parts:
        return None
    spans = [one for one in known if isinstance(one, _Span)]
    if len(spans) < len(known):
        return known[0] if all(one == known[0] for one in known) else None
    if not spans:
        return []
    return _Span(min(one.low for one in spans), max(one.high for one in spans), any(one.chosen for one in spans))
