"""Successes that cannot end the episode, because nothing that decides them decides its end."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from typing import NamedTuple

from .dependence import Dependence, Node, Place, is_local
from .program import Function, Program, Suspect, line, name_of
from .reported import Reported, reported

_FLAGS = 5
_DEPTH = 6
#: The most cases in which one change happens.
_CASES = 64


def ongoing_successes(program: Program) -> Iterator[Suspect]:
    """Find a report of success that shares nothing with the flags of the end, as far as the text shows all of both."""
    step = program.method(program.env, "step")
    if step is None or program.has_unknown_base(program.env):
        return
    values = reported(program, step)
    if not values or all(isinstance(each.value, ast.Constant) for each in values):
        return
    stepping = program.reached("step")
    if any(function.name == "reset" for function in stepping):
        return
    play = _Play(program, step, stepping)
    if play.is_known and (words := play.independent(values)):
        yield Suspect(line(values[0].value), words, certain=False)


class _Test(NamedTuple):
    """A test that holds, or does not, where something happens."""

    text: str
    holds: bool
    node: ast.expr
    fields: frozenset[str]


_Tests = tuple[_Test, ...]


class _TooMany(Exception):
    """There are more cases than are compared."""


class _Event(NamedTuple):
    """One way in which a flag changes: the tests around it, the statement and its calls, and what is in its value."""

    tests: _Tests
    places: tuple[Place, ...] = ()
    made_of: frozenset[Node] = frozenset()


class _Play(Dependence):
    """How success and the end come about."""

    def __init__(self, program: Program, step: Function, functions: list[Function]) -> None:
        super().__init__(program, step, functions)
        self._tests: dict[tuple[ast.expr, bool], _Test] = {}
        self._clocks: dict[str, bool] = {}

    def independent(self, values: list[Reported]) -> str:
        """What to report if nothing that decides success can end the episode, else ""."""
        self._spread_changes()
        successes = [(each.value, each.function) for each in values]
        ends = [
            (flag, self.step)
            for node in self.step.nodes
            if isinstance(node, ast.Return) and isinstance(node.value, ast.Tuple)
            for flag in node.value.elts[_FLAGS - 3 : _FLAGS - 1]
        ]
        roots = {each for flag, function in ends for each in self._reads(flag, function)}
        for node in self.step.nodes:
            if isinstance(node, ast.Return):
                roots |= self._around(node, self.step)
        influences = self._closure(roots)
        decided = self._direct(successes)
        if not decided or decided & influences:
            return ""
        try:
            won, over = list(self._events(successes)), list(self._events(ends))
            if not won or any(self._linked(one, two) for one in won for two in over):
                return ""
        except _TooMany:
            return ""
        names = " and ".join(f"self{name}" for name in sorted(decided))
        return f"reports {values[0].key!r} by {names}, and nothing that decides it can end the episode"

    def _events(self, places: list[tuple[ast.expr, Function]]) -> Iterator[_Event]:
        """How expressions become true: by their own tests, and by changes of the names and attributes in them."""
        seen: set[Node] = set()
        waiting: list[Node] = []
        for expression, place in places:
            for tests in self._cases(expression, True, place, 0):
                yield _Event(tests)
            waiting += self._reads(expression, place)
        while waiting:
            one = waiting.pop()
            if one in seen:
                continue
            seen.add(one)
            for node, value, function in self._writes.get(one, ()):
                if isinstance(value, ast.Constant) and value.value is False:
                    continue
                if not isinstance(one, str) or isinstance(node, ast.Assign | ast.AnnAssign):
                    waiting += self._reads(value, function)
                for way in self._ways(node, function):
                    for event in self._events_of(way, value):
                        yield event
                        read = {field for test in event.tests if test.holds for field in test.fields}
                        waiting += [field for field in read if self._is_flag(field)]

    def _ways(self, node: ast.AST, function: Function) -> list[tuple[Place, ...]]:
        """A node with the calls that lead to it, for each way from step()."""
        found: list[tuple[Place, ...]] = []
        waiting: list[tuple[Place, ...]] = [((node, function),)]
        while waiting:
            way = waiting.pop()
            calls = self._calls.get(way[-1][1], ()) if len(way) <= _DEPTH else ()
            waiting += [(*way, call) for call in calls]
            found += [] if calls else [way]
            if len(waiting) + len(found) > _CASES:
                raise _TooMany
        return found

    def _events_of(self, places: tuple[Place, ...], value: ast.expr | None) -> Iterator[_Event]:
        node, function = places[0]
        made_of = {each for each in self._reads(value, function) if each in self._needs}
        cases: list[_Tests] = [()]
        for place, owner in places:
            cases = _product(cases, self._cases_around(place, owner, _DEPTH))
        if value is not None and isinstance(node, ast.Assign | ast.AnnAssign | ast.Return):
            cases = _product(cases, self._cases(value, True, function, 0))
        for tests in cases:
            yield _Event(tests, places, frozenset(made_of))

    def _is_flag(self, field: str, *others: str) -> bool:
        """Whether one attribute is all, and step() only assigns constants to it."""
        writes = self._writes.get(field, ())
        return not others and bool(writes) and all(isinstance(value, ast.Constant) for _, value, _ in writes)

    def _is_clock(self, field: str) -> bool:
        """Whether each step adds the same to an attribute, and nothing else changes it."""
        if field not in self._clocks:
            writes = self._writes.get(field, ())
            self._clocks[field] = bool(writes) and all(
                isinstance(node, ast.AugAssign)
                and not any(each in self._needs or is_local(each) for each in self._reads(value, function))
                and not any(True for way in self._ways(node, function) for place in way for _ in self._guards(*place))
                for node, value, function in writes
            )
        return self._clocks[field]

    def _cases_around(self, node: ast.AST, function: Function, depth: int) -> list[_Tests]:
        """The cases in which a node runs, by the tests around it."""
        cases: list[_Tests] = [()]
        for test, holds in self._guards(node, function):
            cases = _product(cases, self._cases(test, holds, function, depth))
        return cases

    def _cases(self, node: ast.expr, holds: bool, function: Function, depth: int) -> list[_Tests]:
        """The cases in which an expression is true, or false, each by the tests that hold in it.

        Args:
            node: the expression.
            holds: whether to look for the cases in which it is true.
            function: which contains it.
            depth: how often to put in what names and results stand for.
        """
        match node:
            case ast.BoolOp(op=op, values=values):
                parts = [self._cases(each, holds, function, depth) for each in values]
                if isinstance(op, ast.Or) == holds:
                    return [case for part in parts for case in part]
                cases: list[_Tests] = [()]
                for part in parts:
                    cases = _product(cases, part)
                return cases
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return self._cases(operand, not holds, function, depth)
            case ast.Call(func=ast.Name(id="bool" | "bool_"), args=[operand]):
                return self._cases(operand, holds, function, depth)
            case ast.Constant(value=bool() as value):
                return [()] if value is holds else []
            case ast.Constant():
                return [()]
        sources: list[Node] = []
        if holds and depth and isinstance(node, ast.Name):
            sources = [self._name(node.id, function)]
        elif holds and depth and isinstance(node, ast.Call):
            sources = [*self._called(node)]
        inner = [write for source in sources for write in self._writes.get(source, ())]
        if inner:
            return [
                case
                for place, value, owner in inner
                for case in _product(
                    self._cases_around(place, owner, depth - 1),
                    self._cases(value, True, owner, depth - 1) if value is not None else [()],
                )
            ]
        if (node, holds) not in self._tests:
            self._tests[node, holds] = self._test(node, holds, function)
        return [(self._tests[node, holds],)]

    def _test(self, node: ast.expr, holds: bool, function: Function) -> _Test:
        text, sign, ordered = ast.unparse(node), holds, False
        if isinstance(node, ast.Compare) and len(node.ops) == 1:
            ordered = not isinstance(node.ops[0], ast.Eq | ast.NotEq | ast.In | ast.NotIn)
            if isinstance(node.ops[0], ast.NotEq):
                text, sign = text.replace("!=", "=="), not holds
        # Two limits may be one, two places are two.
        fields = self._direct([(node, function)], fixed=not ordered)
        return _Test(text, sign, node, frozenset(fields))

    def _linked(self, one: _Event, two: _Event) -> bool:
        """Whether the first change may bring about the second, because it answers all tests of the second."""
        if any(_exclude(test, other) for test in one.tests for other in two.tests):
            return False
        if one.made_of & two.made_of or (two.tests and _stated(two.tests) <= _stated(one.tests)):
            return True
        if any(self._beside(first, second) for first in one.places for second in two.places):
            return True
        known = {field for test in one.tests for field in test.fields}
        asked = [test for test in two.tests if test.fields and (test.holds or not self._is_flag(*test.fields))]
        if asked and any(test.fields and all(map(self._is_clock, test.fields)) for test in one.tests):
            # Two counts of time may end at once.
            known |= {field for field in self._needs if isinstance(field, str) and self._is_clock(field)}
        return bool(asked) and all(test.fields <= known for test in asked)

    def _beside(self, one: Place, two: Place) -> bool:
        """Whether one node runs only where the other does, though not in each step."""
        if one[1] is not two[1]:
            return False
        first, second = (list(map(id, self._blocks(node, self.program.parents))) for node, _ in (one, two))
        top = id(one[1].node.body)
        if not first or not second:
            return False
        inner = {first[0], second[0]} & {*first} & {*second}
        return any(each != top or self._sometimes(one[1]) for each in inner)

    def _blocks(self, node: ast.AST, parents: dict[ast.AST, ast.AST]) -> Iterator[list[ast.stmt]]:
        """The blocks around a node, innermost first."""
        while not isinstance(node, ast.FunctionDef):
            parent = parents[node]
            for name in ("body", "orelse"):
                block = getattr(parent, name, None)
                if isinstance(block, list) and node in block:
                    yield block
            node = parent

    def _sometimes(self, function: Function) -> bool:
        """Whether only a branch calls a function."""
        calls = self._calls.get(function, ())
        return function is not self.step and any(
            any(True for place in way for _ in self._guards(*place))
            for call, caller in calls
            for way in self._ways(call, caller)
        )


def _stated(tests: _Tests) -> set[tuple[str, bool]]:
    return {(test.text, test.holds) for test in tests}


def _product(some: list[_Tests], others: list[_Tests]) -> list[_Tests]:
    """The cases in which one of some cases and one of others hold."""
    if len(some) * len(others) > _CASES:
        raise _TooMany
    return [(*one, *two) for one in some for two in others]


def _exclude(one: _Test, two: _Test) -> bool:
    """Whether two tests cannot hold at once."""
    if one.text == two.text:
        return one.holds != two.holds
    match one.node, two.node:
        case (
            ast.Compare(left=left, ops=[ast.Eq()], comparators=[value]),
            ast.Compare(left=other, ops=[ast.Eq()], comparators=[second]),
        ) if one.holds and two.holds and ast.unparse(left) == ast.unparse(other):
            fixed = all(isinstance(each, ast.Constant) or name_of(each).isupper() for each in (value, second))
            return fixed and ast.unparse(value) != ast.unparse(second)
    return False
