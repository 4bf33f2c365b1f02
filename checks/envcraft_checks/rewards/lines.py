"""The lines of an environment that write its reward, read from its syntax tree."""

from __future__ import annotations

import ast
from typing import NamedTuple

from envcraft_checks.linting.program import Function, Program, line, name_of, root
from envcraft_checks.rewards.syntax import (
    SCOPES,
    Binding,
    Scope,
    blocks_to,
    bound_by,
    change_of,
    changes,
    comes_before,
    constant,
    is_fixed,
    is_looped,
    largest,
    place,
    returns,
    summands,
)

_RESULTS = 5
_REWARD = 1
#: Calls of a value that do not change it, and those that only limit it.
_NUMBERS = frozenset({"float", "int", "round", "float32", "float64", "item"})
_LIMITS = frozenset({"clip", "min", "max", "minimum", "maximum"})
#: Names and calls that lead from one to the next, and all of them.
_DEEPEST, _MOST = 30, 2_000


class Unknown(Exception):
    """The tree does not tell what writes the reward."""


class Write(NamedTuple):
    """A place that gives the reward its value, or a part of it.

    Attributes:
        line: of the statement.
        value: what it writes.
        statement: the statement.
        scope: the call of the function that it is part of.
        amount: what it adds to the reward, if the file says so.
        limit: the largest size of what it adds, if the file says so.
        once: whether the reward is the sum of this and of what the other places write, each once.
        sign: 1 if the reward grows with the value, else -1.
    """

    line: int
    value: ast.expr
    statement: ast.stmt
    scope: Scope
    amount: float | None
    limit: float | None
    once: bool
    sign: int

    @property
    def is_zero(self) -> bool:
        return self.amount == 0


class RewardLines:
    """The places in a file that write the reward.

    Args:
        program: the file.

    Raises:
        Unknown: the file has no environment, or its class has no ``step`` in the file.
    """

    def __init__(self, program: Program) -> None:
        self.program = program
        step = program.method(program.env, "step") if program.env in program.classes else None
        if step is None:
            raise Unknown
        self.step = step
        self._known: dict[tuple[frozenset[int] | None, bool], list[Write]] = {}

    def writes(self, ran: frozenset[int] | None = None, deep: bool = True) -> list[Write]:
        """Find the places that write the reward that ``step`` returns.

        Args:
            ran: the lines that a call of it has run; without them, those of every call count.
            deep: whether to follow the terms of a sum and the methods that give the reward.

        Raises:
            Unknown: something else than a value of the file may be the reward, or the lines do not reach the end of
                the call.
        """
        key = ran, deep
        if key not in self._known:
            walk = Walk(self.program, ran, deep)
            try:
                walk.returned(self.step, Scope(self.step), _REWARD)
            except RecursionError as error:
                raise Unknown from error
            if not walk.once:
                walk.found = [write._replace(once=False) for write in walk.found]
            self._known[key] = list({(one.line, id(one.value)): one for one in walk.found}.values())
        return self._known[key]


class Walk:
    """The way from a returned value back to what writes it.

    Args:
        program: the file.
        ran: the lines that ran, if they are known.
        deep: whether to follow terms and methods.

    Attributes:
        found: the places so far.
        once: whether nothing multiplies or limits the reward on the way.
    """

    def __init__(self, program: Program, ran: frozenset[int] | None, deep: bool) -> None:
        self.found: list[Write] = []
        self.once = True
        self._program = program
        self._ran = ran
        self._deep = deep
        self._seen: set[tuple[int, int, int | None]] = set()
        #: Kept, so that no other scope has the id of one that was seen.
        self._scopes: list[Scope] = []
        self._depth = 0

    def ran(self, node: ast.AST) -> bool:
        """Whether a statement may have run."""
        if self._ran is None:
            return True
        return any(number in self._ran for number in range(line(node), (getattr(node, "end_lineno", 0) or 0) + 1))

    def returned(
        self,
        function: Function,
        scope: Scope,
        index: int | None,
        sign: int = 1,
        once: bool = True,
        call: tuple[ast.expr, ast.stmt, Scope] | None = None,
    ) -> None:
        """Follow what a function returns.

        Args:
            function: the function.
            scope: its call.
            index: of the result in the tuple that it returns; None if it is what the function returns.
            sign: by which the result counts.
            once: whether it counts once.
            call: the call, which is the place if nothing is returned.
        """
        values = [(one.value, one) for one in returns(function) if self.ran(one) and one.value is not None]
        if not values and call is not None:
            self._leaf(*call, sign, once)
        elif not values:
            raise Unknown
        for value, statement in values:
            if index is not None and isinstance(value, ast.Tuple) and call is None and len(value.elts) != _RESULTS:
                raise Unknown
            self.follow(value, statement, scope, index, sign, once)

    def follow(
        self,
        value: ast.expr,
        at: ast.stmt,
        scope: Scope,
        index: int | None = None,
        sign: int = 1,
        once: bool = True,
    ) -> None:
        """Find what writes a value.

        Args:
            value: an expression.
            at: its statement.
            scope: the call of the function with the statement.
            index: of the part of a tuple.
            sign: by which it counts.
            once: whether it counts once.
        """
        value = self._plain(value) if index is None else value
        if (id(value), id(scope), index) in self._seen:
            return
        self._seen.add((id(value), id(scope), index))
        self._scopes.append(scope)
        self._depth += 1
        if self._depth > _DEEPEST or len(self._seen) > _MOST:
            raise Unknown
        called = self.called(value, scope)
        local = isinstance(value, ast.Name) and value.id in scope.function.local
        if isinstance(value, ast.Tuple | ast.List) and index is not None:
            if index >= len(value.elts) or any(isinstance(one, ast.Starred) for one in value.elts[: index + 1]):
                raise Unknown
            self.follow(value.elts[index], at, scope, None, sign, once)
        elif called is not None and isinstance(value, ast.Call) and (self._deep or index is not None):
            inner = self.scope(called, value, at, scope)
            self.returned(called, inner, index, sign, once and not inner.repeated, (value, at, scope))
        elif isinstance(value, ast.Name) and local:
            self._name(value.id, value, at, scope, index, sign, once)
        elif isinstance(value, ast.IfExp) and (index is not None or self._is_followed(value, scope)):
            for branch in (value.body, value.orelse):
                self.follow(branch, at, scope, index, sign, False)
        elif isinstance(value, ast.Name) and index is None and not self._is_fixed(value.id):
            raise Unknown
        elif isinstance(value, ast.Attribute) and index is None:
            self._attribute(value, at, scope, sign, once)
        elif index is None and self._deep and self._is_followed(value, scope):
            self._terms(value, at, scope, sign, once)
        elif index is None and self._deep and (items := self.items(value, scope)):
            for place, item, change in items:
                self.follow(item, place, scope, None, -sign if change == "-" else sign, once and change != "*")
        elif index is not None and isinstance(at, ast.Return):
            # What gives the whole result is elsewhere.
            raise Unknown
        else:
            self._leaf(value, at, scope, sign, once)
        self._depth -= 1

    def _leaf(self, value: ast.expr, at: ast.stmt, scope: Scope, sign: int, once: bool) -> None:
        known = constant(value, scope, self._program)
        number = line(value) if isinstance(at, ast.Assign) and isinstance(at.value, ast.Dict) else line(at)
        amount = sign * known if known is not None else None
        once = once and not scope.repeated and not is_looped(at, scope, self._program)
        limit = largest(value, scope, self._program)
        self.found.append(Write(number, value, at, scope, amount, limit, once and self.is_sure(at), sign))

    def is_sure(self, statement: ast.stmt) -> bool:
        """Whether a statement has run if its line has: it does not share it with a condition."""
        parent = self._program.parents.get(statement)
        return not isinstance(parent, ast.stmt) or isinstance(parent, SCOPES) or line(parent) != line(statement)

    def _plain(self, value: ast.expr) -> ast.expr:
        """An expression without what only converts or limits it."""
        while isinstance(value, ast.Call) and not value.keywords:
            name = name_of(value.func)
            method = isinstance(value.func, ast.Attribute) and not isinstance(value.func.value, ast.Name)
            if name in _NUMBERS and len(value.args) == 1:
                value = value.args[0]
            elif name in _NUMBERS | {"clip"} and isinstance(value.func, ast.Attribute) and (name == "item" or method):
                self.once = self.once and name == "item"
                value = value.func.value
            elif name in _LIMITS and len(value.args) > 1 and not (name == "clip" and is_fixed(value.args[0])):
                inner = [one for one in value.args if not is_fixed(one)]
                inner = value.args[:1] if name == "clip" else inner
                if len(inner) != 1:
                    return value
                self.once, value = False, inner[0]
            else:
                return value
        return value

    # Names

    def _name(
        self, name: str, use: ast.expr, at: ast.stmt, scope: Scope, index: int | None, sign: int, once: bool
    ) -> None:
        bound = self.bindings(name, scope)
        if not bound:
            if name not in scope.arguments:
                # Only the caller of step() knows its argument.
                if index is None and not scope.arguments and scope.function.name == "step":
                    raise Unknown
                self._leaf(use, at, scope, sign, once)
                return
            value, statement, outer = scope.arguments[name]
            self.follow(value, statement, outer, index, sign, once)
            return
        reaching = self.reaching(bound, at, scope)
        for one in reaching:
            self._bound(one, name, scope, index, sign, once)
        if any(one.change == "*" for one in reaching):
            self.once = False

    def _bound(self, one: Binding, name: str, scope: Scope, index: int | None, sign: int, once: bool) -> None:
        """Follow one binding of a name or an attribute."""
        if one.change == "=":
            if one.part is not None and index is not None:
                raise Unknown
            self.follow(one.value, one.statement, scope, index if one.part is None else one.part, sign, once)
            return
        sign = -sign if one.change == "-" else sign
        once = once and one.change != "*"
        if self._deep and one.change != "*" and self._is_followed(one.value, scope, alone=True):
            self.follow(one.value, one.statement, scope, None, sign, once)
        else:
            self._leaf(one.value, one.statement, scope, sign, once)

    def _is_fixed(self, name: str) -> bool:
        """Whether only the module binds a name, outside functions."""
        changed = any(isinstance(node, ast.Global) and name in node.names for node in self._program.nodes)
        return name in self._program.module_values and not changed

    def bindings(self, name: str, scope: Scope) -> list[Binding]:
        """The statements of a function that bind a name, in the order of the text."""
        found: list[Binding] = []
        known = 0
        nodes = scope.function.nodes
        for node in nodes:
            for target, one in bound_by(node, self._program):
                if isinstance(target, ast.Name) and target.id == name:
                    known += 1
                    found += changes(one, lambda part: isinstance(part, ast.Name) and part.id == name, self._plain)
        stored = [
            node
            for node in nodes
            if isinstance(node, ast.Name) and node.id == name and not isinstance(node.ctx, ast.Load)
        ]
        if len(stored) != known:
            # A loop, a pattern or a context manager binds it.
            raise Unknown
        return sorted((one for one in found if self.ran(one.statement)), key=lambda one: place(one.statement))

    def reaching(self, bound: list[Binding], use: ast.stmt, scope: Scope) -> list[Binding]:
        """The bindings whose value may still be there at a statement of the same function."""
        blocks = {one.statement: blocks_to(one.statement, self._program) for one in bound}
        blocks[use] = blocks_to(use, self._program)
        certain = self._ran is not None and not scope.repeated

        def is_lost(one: Binding) -> bool:
            start = blocks[one.statement]
            if one.statement is not use and not comes_before(start, blocks[use]):
                return True
            for other in bound:
                middle = blocks[other.statement]
                if other.change != "=" or other.statement is one.statement:
                    continue
                if not (comes_before(start, middle, looped=False) and comes_before(middle, blocks[use], False)):
                    continue
                outer = [step[:2] for step in middle]
                always = outer in ([step[:2] for step in way[: len(outer)]] for way in (start, blocks[use]))
                if always or (certain and self.is_sure(other.statement)):
                    return True
            return False

        return [one for one in bound if not is_lost(one)]

    # Attributes and items

    def _attribute(self, value: ast.Attribute, at: ast.stmt, scope: Scope, sign: int, once: bool) -> None:
        own = self.field_bindings(value, scope)
        if not own:
            method = self._program.method(self._program.bound_to(scope.function), scope.function.field(value))
            if method is not None and "property" in {name_of(one) for one in method.node.decorator_list}:
                self.returned(method, Scope(method), None, sign, once, (value, at, scope))
            else:
                self._leaf(value, at, scope, sign, once)
            return
        here = [one for function, one in own if function is scope.function]
        # Without a first value in this call it is what all calls before have added up.
        once = once and len(here) == len(own) and any(one.change == "=" for one in here)
        reached = self.reaching(here, at, scope)
        for function, one in own:
            if function is not scope.function:
                self._bound(one, value.attr, Scope(function, repeated=True), None, sign, False)
            elif one in reached:
                self._bound(one, value.attr, scope, None, sign, once)

    def field_bindings(self, value: ast.Attribute, scope: Scope) -> list[tuple[Function, Binding]]:
        """The statements that bind an attribute, those of play if there are any."""
        mine = bool(scope.function.field(value))
        found: list[tuple[Function, Binding]] = []
        for function in self._program.all:
            same = self._program.bound_to(function) == self._program.bound_to(scope.function)

            def is_it(part: ast.AST, function: Function = function, same: bool = same) -> bool:
                if not isinstance(part, ast.Attribute) or part.attr != value.attr:
                    return False
                return (same and bool(function.field(part))) if mine else True

            for node in function.nodes:
                for target, one in bound_by(node, self._program):
                    if is_it(target) and self.ran(one.statement):
                        found += [(function, change) for change in changes(one, is_it, self._plain)]
        stepped = set(self._program.reached("step"))
        played = [one for one in found if one[0] in stepped]
        return sorted(played or (found if self._ran is None else []), key=lambda one: place(one[1].statement))

    def items(self, value: ast.expr, scope: Scope) -> list[tuple[ast.stmt, ast.expr, str]]:
        """What is put into a local dictionary whose item or sum an expression is; empty if it is not such a thing."""
        key: ast.Constant | None = None
        match value:
            case ast.Subscript(value=ast.Name() as held, slice=ast.Constant() as key):
                pass
            case ast.Call(
                func=ast.Name(id="sum"),
                args=[ast.Call(func=ast.Attribute(value=ast.Name() as held, attr="values"))],
            ):
                pass
            case _:
                return []
        if held.id not in scope.function.local:
            return []
        bound = self.bindings(held.id, scope)
        if not bound or not all(isinstance(one.value, ast.Dict) and one.change == "=" for one in bound):
            return []
        found: list[tuple[str, Binding]] = []
        for one in bound:
            assert isinstance(one.value, ast.Dict)
            for name, part in zip(one.value.keys, one.value.values, strict=True):
                if not isinstance(name, ast.Constant):
                    return []
                found.append((repr(name.value), Binding(one.statement, part, "=")))
        for node in scope.function.nodes:
            if not isinstance(node, ast.Assign | ast.AugAssign):
                continue
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            if isinstance(target, ast.Subscript) and name_of(root(target)) == held.id and self.ran(node):
                if not isinstance(target.slice, ast.Constant):
                    return []
                change = change_of(node.op) if isinstance(node, ast.AugAssign) else "="
                found.append((repr(target.slice.value), Binding(node, node.value, change)))
        at = self._program.parents[value]
        while not isinstance(at, ast.stmt):
            at = self._program.parents[at]
        names = dict.fromkeys(name for name, _ in found)
        wanted = [name for name in names if key is None or name == repr(key.value)]
        reached = [
            one for name in wanted for one in self.reaching([one for other, one in found if other == name], at, scope)
        ]
        return [(one.statement, one.value, one.change) for one in reached]

    # Terms and calls

    def _terms(self, value: ast.expr, at: ast.stmt, scope: Scope, sign: int, once: bool) -> None:
        """Follow those terms of a sum that have places of their own; the others are one place."""
        others: list[tuple[ast.expr, int]] = []
        for term, way in summands(value):
            plain = self._plain(term)
            if self._is_followed(plain, scope, alone=True):
                self.follow(plain, at, scope, None, sign * way, once)
            else:
                others.append((term, way))
        amounts = [constant(term, scope, self._program) for term, _ in others]
        known = [amount * way for amount, (_, way) in zip(amounts, others, strict=True) if amount is not None]
        if others:
            amount = sign * sum(known) if len(known) == len(others) else None
            number = len(self.found)
            single, way = others[0] if len(others) == 1 else (value, 1)
            self._leaf(single, at, scope, sign * way, once)
            sizes = [largest(term, scope, self._program) for term, _ in others]
            limit = sum(size or 0.0 for size in sizes) if None not in sizes else None
            self.found[number] = self.found[number]._replace(amount=amount, limit=limit)

    def _is_followed(self, value: ast.expr, scope: Scope, alone: bool = False) -> bool:
        """Whether a value, or a part of a sum or a choice, has places of its own: a call of a function of the file, or
        a name that such a call or several statements bind.
        """
        value = self._plain(value)
        if self.called(value, scope) is not None and self._deep:
            return True
        if isinstance(value, ast.Name) and value.id in scope.function.local:
            try:
                bound = self._all_bindings(value.id, scope)
                parts = [part for one in bound for part in _choices(one.value)]
                several = len(bound) > 1 or any(self.called(part, scope) is not None for part in parts)
                return alone and self._deep and several
            except Unknown:
                return False
        if isinstance(value, ast.IfExp):
            return any(self._is_followed(part, scope, alone=True) for part in (value.body, value.orelse))
        terms = list(summands(value))
        return terms[0][0] is not value and any(self._is_followed(term, scope, alone=True) for term, _ in terms)

    def _all_bindings(self, name: str, scope: Scope) -> list[Binding]:
        ran, self._ran = self._ran, None
        try:
            return self.bindings(name, scope)
        finally:
            self._ran = ran

    def called(self, value: ast.expr, scope: Scope) -> Function | None:
        """The function of the file that an expression calls."""
        if not isinstance(value, ast.Call):
            return None
        function, program = scope.function, self._program
        target = value.func
        if isinstance(target, ast.Name):
            return None if target.id in function.local else program.functions.get(target.id)
        if not isinstance(target, ast.Attribute):
            return None
        owner = program.bound_to(function)
        if function.field(target):
            return program.method(owner, target.attr)
        if isinstance(target.value, ast.Call) and name_of(target.value.func) == "super":
            return program.method(owner, target.attr, after=function.owner)
        if isinstance(target.value, ast.Attribute | ast.Name) and target.attr not in ("step", "reset"):
            others = [name for name in program.own_classes if name not in program.lineage(program.env)]
            named = [one for name in others for one in program.methods(name) if one.name == target.attr]
            return named[0] if len(set(named)) == 1 else None
        return None

    def scope(self, called: Function, call: ast.Call, at: ast.stmt, scope: Scope) -> Scope:
        """The scope of a call."""
        return Scope(called, self._arguments(called, call, at, scope), self._is_repeated(called, call, scope))

    def _is_repeated(self, called: Function, call: ast.Call, scope: Scope) -> bool:
        if scope.repeated or is_looped(call, scope, self._program):
            return True
        sites = [one for one in self._program.nodes if isinstance(one, ast.Call) and name_of(one.func) == called.name]
        return len(sites) > 1

    def _arguments(
        self, called: Function, call: ast.Call, at: ast.stmt, scope: Scope
    ) -> dict[str, tuple[ast.expr, ast.stmt, Scope]]:
        if any(isinstance(one, ast.Starred) for one in call.args):
            return {}
        names = called.parameters[1:] if called.me else called.parameters
        given = dict(zip(names, call.args, strict=False))
        given |= {one.arg: one.value for one in call.keywords if one.arg}
        return {name: (value, at, scope) for name, value in given.items()}


def _choices(value: ast.expr) -> list[ast.expr]:
    return [value.body, value.orelse] if isinstance(value, ast.IfExp) else [value]
