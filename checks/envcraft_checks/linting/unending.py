"""Successes that cannot end the episode, because nothing that decides them decides its end."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from .program import Function, Program, Suspect, arguments, line, name_of, root
from .told import Told, told

#: An attribute of any object, by its name; the result of a function; a name in a function, or of the module.
_Node = str | Function | tuple[Function | None, str]

#: A node, and the function that contains it.
_Place = tuple[ast.AST, Function]

#: A statement or a call, the value that it assigns, and the function that contains it.
_Write = tuple[ast.AST, ast.expr | None, Function]

#: Methods that only read what they belong to.
_READERS = frozenset({
    "all", "any", "astype", "copy", "count", "endswith", "flatten", "format", "get", "index", "intersection",
    "isdisjoint", "issubset", "items", "join", "keys", "max", "mean", "min", "nonzero", "ravel", "startswith", "sum",
    "tolist", "union", "values",
})  # fmt: skip
#: Built-in functions whose result is, or gives, what they are given; and those of libraries.
_GIVING = frozenset({
    "enumerate", "filter", "getattr", "iter", "list", "max", "min", "next", "reversed", "sorted", "zip",
})  # fmt: skip
_VIEWS = frozenset({"asarray", "atleast_1d", "atleast_2d", "ravel", "reshape", "transpose"})
#: Functions that take something from their first argument.
_TAKING = frozenset({"heappop", "heappushpop", "heapreplace", "next", "setdefault"})
#: Functions that take the environment and do not change it.
_HARMLESS = frozenset({"isinstance", "super"})
#: Names that reach attributes which the text does not show.
_HIDING = frozenset({"__dict__", "delattr", "eval", "exec", "setattr", "vars"})
_FLAGS = 5
_DEPTH = 6
#: The most cases in which one change happens.
_CASES = 64


def ongoing_successes(program: Program) -> Iterator[Suspect]:
    """Find a report of success that shares nothing with the flags of the end, as far as the text shows all of both."""
    step = program.method(program.env, "step")
    if step is None or program.has_unknown_base(program.env):
        return
    values = told(program, step)
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
    places: tuple[_Place, ...] = ()
    made_of: frozenset[_Node] = frozenset()


class _Play:
    """What depends on what in the functions that step() may call.

    Attributes of the same name are taken for one, whatever their object, and so are methods. The order of statements
    does not count. So this finds too many dependencies rather than too few.
    """

    def __init__(self, program: Program, step: Function, functions: list[Function]) -> None:
        self.program = program
        self.step = step
        self.functions = functions
        self._named: dict[str, list[Function]] = defaultdict(list)
        for function in functions:
            self._named[function.name].append(function)
        self._needs: dict[_Node, set[_Node]] = defaultdict(set)
        self._aliases: dict[_Node, set[_Node]] = defaultdict(set)
        self._calls: dict[Function, list[tuple[ast.AST, Function]]] = defaultdict(list)
        self._writes: dict[_Node, list[_Write]] = defaultdict(list)
        self._tests: dict[tuple[ast.expr, bool], _Test] = {}
        self._clocks: dict[str, bool] = {}
        self._changed: list[tuple[_Node, set[_Node], _Write]] = []
        self.is_known = all(map(self._is_known, functions))
        if self.is_known:
            for function in functions:
                for node in function.nodes:
                    self._add(node, function)

    def _is_known(self, function: Function) -> bool:
        """Whether all calls and attributes of a function are known."""
        for node in function.nodes:
            match node:
                case ast.FunctionDef() | ast.ClassDef() | ast.AsyncFunctionDef() | ast.Yield() | ast.Await():
                    return False
                case ast.Name(id=name) | ast.Attribute(attr=name) if name in _HIDING:
                    return False
                case ast.Name(id=name) if name == function.me:
                    if not self._is_seen(node, function):
                        return False
                case ast.Call(func=ast.Attribute(attr=attr) as called) if function.field(called):
                    owner = self.program.bound_to(function)
                    if not self.program.method(owner, attr) and attr not in self.program.field_values(owner):
                        return False
        return True

    def _is_seen(self, node: ast.Name, function: Function) -> bool:
        """Whether a mention of ``self`` only reads or sets an attribute, or goes to a function of the file."""
        parent = self.program.parents[node]
        if isinstance(parent, ast.Attribute):
            return True
        if isinstance(parent, ast.keyword):
            parent = self.program.parents[parent]
        return isinstance(parent, ast.Call) and (name_of(parent) in _HARMLESS or bool(self._called(parent)))

    def _called(self, call: ast.Call) -> list[Function]:
        """The functions of the file that a call may mean, by the name alone."""
        name = name_of(call.func) if isinstance(call.func, ast.Name | ast.Attribute) else ""
        if name in self.program.classes:
            return [one for one in self._named["__init__"] if one.owner in self.program.lineage(name)]
        return self._named.get(name, [])

    # What an expression reads.

    def _reads(self, node: ast.AST | None, function: Function) -> set[_Node]:
        found: set[_Node] = set()
        waiting = [node] if node is not None else []
        while waiting:
            one = waiting.pop()
            if isinstance(one, ast.Name):
                if one.id != function.me:
                    found.add(self._name(one.id, function))
            elif isinstance(one, ast.Attribute):
                if self.program.path(one, function):
                    continue
                found.add(f".{one.attr}")
                found.update(self._named.get(one.attr, ()))
                waiting.append(one.value)
            else:
                waiting += ast.iter_child_nodes(one)
        return found

    def _name(self, name: str, function: Function) -> _Node:
        if name in function.local:
            return function, name
        return self.program.functions.get(name) or (None, name)

    def _objects(self, node: ast.expr | None, function: Function) -> set[_Node]:
        """The names and attributes whose object, or a part of it, an expression may be."""
        match node:
            case ast.Name():
                return {self._name(node.id, function)} if node.id != function.me else set()
            case ast.Attribute():
                return {f".{node.attr}"} if not self.program.path(node, function) else set()
            case ast.Subscript(value=value) | ast.Starred(value=value) | ast.NamedExpr(value=value):
                return self._objects(value, function)
            case ast.Call(func=func, args=args):
                if called := self._called(node):
                    return set(called)
                path = self.program.path(func, function)
                if path.startswith("builtins.") and name_of(func) not in _GIVING:
                    return set()
                if path and not path.startswith("builtins.") and name_of(func) not in _VIEWS:
                    return set()
                inner = [func.value] if isinstance(func, ast.Attribute) and not path else []
                return {each for one in [*inner, *args] for each in self._objects(one, function)}
            case ast.BoolOp(values=values) | ast.Tuple(elts=values) | ast.List(elts=values):
                return {each for one in values for each in self._objects(one, function)}
            case ast.IfExp(body=one, orelse=two) | ast.BinOp(op=ast.Add(), left=one, right=two):
                return self._objects(one, function) | self._objects(two, function)
            case ast.ListComp(generators=generators) | ast.GeneratorExp(generators=generators):
                return {each for one in generators for each in self._objects(one.iter, function)}
        return set()

    # What statements write.

    def _add(self, node: ast.AST, function: Function) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    self._set(target, value, node, function)
            case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.NamedExpr(target=target, value=value):
                self._set(target, value, node, function)
            case ast.AugAssign(target=target, value=value):
                self._set(target, value, node, function)
            case ast.For(target=target, iter=value) | ast.comprehension(target=target, iter=value):
                self._set(target, value, node, function)
            case ast.withitem(context_expr=value, optional_vars=ast.expr() as target):
                self._set(target, value, node, function)
            case ast.Delete(targets=targets):
                for target in targets:
                    self._set(target, None, node, function)
            case ast.Return(value=value):
                needed = self._reads(value, function) | self._around(node, function)
                self._needs[function] |= needed
                self._writes[function].append((node, value, function))
                self._aliases[function] |= self._objects(value, function)
            case ast.Call():
                self._call(node, function)

    def _set(self, target: ast.expr, value: ast.expr | None, node: ast.AST, function: Function) -> None:
        if isinstance(target, ast.Tuple | ast.List):
            parts = value.elts if isinstance(value, ast.Tuple | ast.List) else []
            pairs = parts if len(parts) == len(target.elts) else [value] * len(target.elts)
            for one, each in zip(target.elts, pairs, strict=True):
                self._set(one, each, node, function)
            return
        if isinstance(target, ast.Starred):
            target = target.value
        needed = self._reads(value, function) | self._around(node, function)
        if isinstance(target, ast.Subscript):
            needed |= self._reads(target.slice, function)
            self._change(root(target), needed, value, node, function)
        elif isinstance(target, ast.Name):
            name = self._name(target.id, function)
            self._needs[name] |= needed
            self._aliases[name] |= self._objects(value, function)
            self._writes[name].append((node, value, function))
            if isinstance(node, ast.AugAssign):
                self._change(target, needed, value, node, function)
        elif isinstance(target, ast.Attribute):
            self._needs[f".{target.attr}"] |= needed | self._reads(target.value, function)
            self._aliases[f".{target.attr}"] |= self._objects(value, function)
            self._writes[f".{target.attr}"].append((node, value, function))

    def _change(
        self, changed: ast.expr, needed: set[_Node], value: ast.expr | None, node: ast.AST, function: Function
    ) -> None:
        """Note that an object changes in place."""
        for each in self._objects(changed, function):
            self._needs[each] |= needed
            self._writes[each].append((node, value, function))
            self._changed.append((each, needed, (node, value, function)))

    def _call(self, call: ast.Call, function: Function) -> None:
        given = [*call.args, *(keyword.value for keyword in call.keywords)]
        around = self._around(call, function)
        called = self._called(call)
        for one in called:
            self._calls[one].append((call, function))
            self._needs[one, ""] |= around
            known = dict(arguments(call, one))
            for name in one.parameters:
                values = [known[name]] if name in known else given if call.keywords or call.args else []
                for value in values:
                    self._needs[one, name] |= self._reads(value, function)
                    self._aliases[one, name] |= self._objects(value, function)
        if called:
            return
        needed = around | {each for one in given for each in self._reads(one, function)}
        owner = call.func.value if isinstance(call.func, ast.Attribute) else None
        path = self.program.path(call.func, function)
        if owner is not None and not path:
            draws = "random" in name_of(owner).lower() or "rng" in name_of(owner).lower()
            if name_of(call) not in _READERS and not draws:
                self._change(root(owner), needed, call, call, function)
        if (
            call.args
            and (owner is None or path or name_of(call) == "shuffle")
            and (isinstance(self.program.parents[call], ast.Expr) or name_of(call) in _TAKING)
        ):
            # Functions of libraries change their first argument, if any.
            self._change(root(call.args[0]), needed, call, call, function)

    def _around(self, node: ast.AST, function: Function) -> set[_Node]:
        """What decides whether a node runs."""
        found: set[_Node] = {(function, "")}
        for test, _ in self._guards(node, function):
            found |= self._reads(test, function)
        for loop in self._loops(node, function):
            found |= self._reads(loop.iter, function) if isinstance(loop, ast.For) else set()
        loops = set(self._loops(node, function))
        for leave in self._exits(function):
            if line(leave) < line(node) or not loops.isdisjoint(self._loops(leave, function)):
                for test, _ in self._guards(leave, function):
                    found |= self._reads(test, function)
        return found

    def _exits(self, function: Function) -> list[ast.AST]:
        leaving = (ast.Return, ast.Raise, ast.Break, ast.Continue)
        return [node for node in function.nodes if isinstance(node, leaving)]

    def _loops(self, node: ast.AST, function: Function) -> Iterator[ast.AST]:
        while node is not function.node:
            if isinstance(node, ast.For | ast.While):
                yield node
            node = self.program.parents[node]

    def _guards(self, node: ast.AST, function: Function) -> Iterator[tuple[ast.expr, bool]]:
        """The tests around a node, and whether they hold there."""
        while node is not function.node:
            parent = self.program.parents[node]
            match parent:
                case ast.If(test=test, orelse=orelse) if test is not node:
                    yield test, node not in orelse
                case ast.While(test=test) if test is not node:
                    yield test, True
                case ast.IfExp(test=test, orelse=orelse) if test is not node:
                    yield test, node is not orelse
                case ast.Match(subject=subject) if subject is not node:
                    yield subject, True
                case ast.match_case(guard=ast.expr() as test) if test is not node:
                    yield test, True
            node = parent

    # Whether success and the end are independent.

    def independent(self, values: list[Told]) -> str:
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

    def _spread_changes(self) -> None:
        """A change in place reaches each name of the object."""
        for start, needed, write in self._changed:
            seen: set[_Node] = {start}
            waiting = [start]
            while waiting:
                for other in self._aliases.get(waiting.pop(), ()):
                    if other not in seen:
                        seen.add(other)
                        waiting.append(other)
                        self._needs[other] |= needed
                        self._writes[other].append(write)

    def _closure(self, nodes: Iterable[_Node]) -> set[_Node]:
        found = set(nodes)
        waiting = list(found)
        while waiting:
            one = waiting.pop()
            needed = self._needs.get(one, set())
            if isinstance(one, tuple) and one[0] is not None:
                needed = needed | {(one[0], "")}
            new = needed - found
            found |= new
            waiting += new
        return found

    def _direct(self, places: Iterable[tuple[ast.expr | None, Function]], fixed: bool = False) -> set[str]:
        """The attributes of which expressions are made, through names and results: with or without fixed ones."""
        found: set[_Node] = {each for value, function in places for each in self._reads(value, function)}
        waiting = [each for each in found if not isinstance(each, str)]
        while waiting:
            new = {each for each in self._needs.get(waiting.pop(), ()) if not _runs(each)} - found
            found |= new
            waiting += [each for each in new if not isinstance(each, str)]
        return {each for each in found if isinstance(each, str) and (fixed or each in self._needs)}

    def _events(self, places: list[tuple[ast.expr, Function]]) -> Iterator[_Event]:
        """How expressions become true: by their own tests, and by changes of the names and attributes in them."""
        seen: set[_Node] = set()
        waiting: list[_Node] = []
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

    def _ways(self, node: ast.AST, function: Function) -> list[tuple[_Place, ...]]:
        """A node with the calls that lead to it, for each way from step()."""
        found: list[tuple[_Place, ...]] = []
        waiting: list[tuple[_Place, ...]] = [((node, function),)]
        while waiting:
            way = waiting.pop()
            calls = self._calls.get(way[-1][1], ()) if len(way) <= _DEPTH else ()
            waiting += [(*way, call) for call in calls]
            found += [] if calls else [way]
            if len(waiting) + len(found) > _CASES:
                raise _TooMany
        return found

    def _events_of(self, places: tuple[_Place, ...], value: ast.expr | None) -> Iterator[_Event]:
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
                and not any(each in self._needs or _is_local(each) for each in self._reads(value, function))
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
        sources: list[_Node] = []
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
        if one.made_of & two.made_of:
            return True
        if any(self._beside(first, second) for first in one.places for second in two.places):
            return True
        known = {field for test in one.tests for field in test.fields}
        asked = [test for test in two.tests if test.fields and (test.holds or not self._is_flag(*test.fields))]
        if asked and any(test.fields and all(map(self._is_clock, test.fields)) for test in one.tests):
            # Two counts of time may end at once.
            known |= {field for field in self._needs if isinstance(field, str) and self._is_clock(field)}
        return bool(asked) and all(test.fields <= known for test in asked)

    def _beside(self, one: _Place, two: _Place) -> bool:
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


def _product(some: list[_Tests], others: list[_Tests]) -> list[_Tests]:
    """The cases in which one of some cases and one of others hold."""
    if len(some) * len(others) > _CASES:
        raise _TooMany
    return [(*one, *two) for one in some for two in others]


def _is_local(node: _Node) -> bool:
    return isinstance(node, tuple) and node[0] is not None


def _runs(node: _Node) -> bool:
    return isinstance(node, tuple) and node[1] == ""


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
