"""Differences and comparisons of two values that the code has read without any change in between."""

from __future__ import annotations

import ast
from collections.abc import Hashable, Iterable, Iterator
from itertools import count
from typing import NamedTuple

from .flow import NEUTRAL
from .program import MUTATORS, Function, Program, Suspect, line, name_of, root
from .usage import Usage, creates

#: Built-in functions that only calculate, and give the same result again.
_BUILTINS = frozenset({
    "abs", "all", "any", "bool", "divmod", "enumerate", "float", "int", "isinstance", "len", "list", "max", "min",
    "pow", "range", "reversed", "round", "set", "sorted", "str", "sum", "tuple", "zip",
})  # fmt: skip
#: Functions of NumPy that change their arguments.
_IN_PLACE = frozenset({"copyto", "fill_diagonal", "place", "put", "putmask"})
#: Methods of Python's, NumPy's and pygame's objects that only calculate.
_METHODS = frozenset({
    "all", "any", "argmax", "argmin", "astype", "colliderect", "copy", "count", "distance_squared_to", "distance_to",
    "flatten", "get", "index", "issubset", "item", "items", "keys", "length", "length_squared", "max", "mean", "min",
    "nonzero", "ravel", "reshape", "round", "sum", "tolist", "values",
})  # fmt: skip
_RANDOM = frozenset({"_np_random", "_rng", "np_random", "random", "rng"})


class _Effects(NamedTuple):
    """What code may change, and what its result depends on.

    Attributes:
        reads: attributes of ``self``.
        writes: attributes of ``self`` that it binds.
        inside: whether it may change an object.
        anything: whether it may change any attribute.
        steady: whether it gives the same result again if nothing has changed.
    """

    reads: frozenset[str] = frozenset()
    writes: frozenset[str] = frozenset()
    inside: bool = False
    anything: bool = False
    steady: bool = True

    def __or__(self, other: _Effects) -> _Effects:
        return _Effects(
            self.reads | other.reads,
            self.writes | other.writes,
            self.inside or other.inside,
            self.anything or other.anything,
            self.steady and other.steady,
        )

    @property
    def harmless(self) -> bool:
        """Whether it changes nothing."""
        return not (self.writes or self.inside or self.anything)


_TESTS = (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE)

_UNKNOWN = _Effects(inside=True, anything=True, steady=False)


class _Value(NamedTuple):
    """What a name or an attribute holds: two values with the same key are equal."""

    key: Hashable
    text: str
    line: int


class _State:
    """What is known at one place of a function."""

    def __init__(self, names: dict[str, _Value], fields: dict[str, _Value], time: tuple[int, int]) -> None:
        self.names = names
        self.fields = fields
        #: Numbers that change when any attribute, and when any object, may have changed.
        self.time = time

    def copy(self) -> _State:
        return _State({**self.names}, {**self.fields}, self.time)


def equal_values(program: Program) -> Iterator[Suspect]:
    """Find differences and comparisons whose two sides are always equal, although they stand for two values."""
    reading = _Reading(program)
    usage = Usage(program, told=False)
    for function in program.play:
        if not any(_candidates(function)):
            continue
        for node, one, other in _Walk(program, function, reading).found:
            if usage.is_used(node, function):
                lines = sorted({one.line, other.line})
                same = f"{one.text[:40]} has not changed since line {lines[0]} read it"
                if lines[-1] != line(node):
                    same = f"lines {lines[0]} and {lines[-1]} read the same {one.text[:40]}"
                yield Suspect(line(node), f"uses {ast.unparse(node)[:60]}, whose sides are always equal: {same}")


def _sides(node: ast.AST) -> tuple[ast.expr, ast.expr] | None:
    """The sides of a difference or a comparison."""
    match node:
        case ast.BinOp(left=left, op=ast.Sub(), right=right):
            return left, right
        case ast.Compare(left=left, ops=[op], comparators=[right]) if isinstance(op, _TESTS):
            return left, right
    return None


def _candidates(function: Function) -> Iterator[bool]:
    """Whether each difference and comparison may have equal sides, by the texts that its sides are bound to."""
    values: dict[str, list[ast.expr]] = {}
    for target, value, _ in function.bindings:
        if value is not None and (name := _named(target, function)):
            values.setdefault(name, []).append(value)
    for node in function.nodes:
        if (sides := _sides(node)) is not None and any(_named(side, function) in values for side in sides):
            one, other = (
                {ast.unparse(each) for each in [side, *values.get(_named(side, function), ())]} for side in sides
            )
            yield not one.isdisjoint(other)


def _named(node: ast.expr, function: Function) -> str:
    """The name, or the attribute of ``self``, that a node is; "" for any other node."""
    field = function.field(node)
    return f"self.{field}" if field else node.id if isinstance(node, ast.Name) else ""


class _Reading:
    """What the functions of a file may change and what they read."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self._known: dict[Function, _Effects] = {}
        self._methods = {one.name for owner in program.classes for one in program.methods(owner)}
        self.computed = {
            one.name for owner in program.classes for one in program.methods(owner) if one.node.decorator_list
        }
        #: Names of the module that functions bind.
        self.rebound = {name for node in program.nodes if isinstance(node, ast.Global) for name in node.names}
        #: Attributes that play changes.
        self.changing = {
            node.attr
            for one in program.play
            for node in one.nodes
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del)
        } | {name_of(target) for one in program.play for target, _ in one.writes}

    def of(self, function: Function) -> _Effects:
        """What a function may change, whatever it gets."""
        if function not in self._known:
            # A function that calls itself is not followed.
            self._known[function] = _UNKNOWN
            odd = ast.Global | ast.Nonlocal | ast.Yield | ast.YieldFrom | ast.Await
            if not any(isinstance(node, odd) for node in function.nodes):
                self._known[function] = self.effects(function.nodes, function)
        return self._known[function]

    def effects(self, nodes: Iterable[ast.AST], function: Function) -> _Effects:
        """What some nodes of a function may change."""
        found = _Effects()
        for node in nodes:
            match node:
                case ast.Call():
                    found |= self._call(node, function)
                case ast.Attribute(attr=attr, ctx=ast.Load()):
                    method = self.program.method(self.program.bound_to(function), attr)
                    if function.field(node) and method is None:
                        found |= _Effects(reads=frozenset({attr}))
                    elif function.field(node) and method is not None:
                        found |= self.of(method) if method.node.decorator_list else _Effects()
                    elif attr in self.computed:
                        found |= _UNKNOWN
                case ast.Attribute(attr=attr) if attr in self.computed:
                    found |= _UNKNOWN
                case ast.Attribute(attr=attr):
                    mine = bool(function.field(node))
                    found |= _Effects(writes=frozenset({attr} if mine else ()), inside=not mine)
                case ast.Subscript(ctx=ast.Store() | ast.Del()) if not self._is_new(root(node), function):
                    found |= _Effects(inside=True)
                case ast.AugAssign(target=target) if not self._is_number(target, function):
                    found |= _Effects(inside=True)
                case ast.With() | ast.AsyncWith() | ast.Await() | ast.Yield() | ast.YieldFrom():
                    found |= _UNKNOWN
        return found

    def _call(self, call: ast.Call, function: Function) -> _Effects:
        program, name = self.program, name_of(call)
        if (called := program.called(call, function)) is not None:
            return self.of(called)
        path = program.path(call.func, function)
        if path == "builtins.print" or path.startswith("logging."):
            return _Effects(steady=False)
        if path.startswith(("random.", "numpy.random.", "time.")):
            return _Effects(inside=name == "shuffle", steady=False)
        if path.startswith("builtins."):
            return _Effects() if name in _BUILTINS else _UNKNOWN
        if path.startswith(("math.", "numpy.")):
            changes = name in _IN_PLACE or any(keyword.arg == "out" for keyword in call.keywords)
            return _Effects(inside=changes)
        if isinstance(call.func, ast.Name) and name in program.classes:
            return self._created(name)
        if not isinstance(call.func, ast.Attribute):
            return _UNKNOWN
        if name in self._methods:
            return self._of_others(name)
        receiver = call.func.value
        if name_of(receiver) in _RANDOM:
            return _Effects(inside=name == "shuffle", steady=False)
        if name in MUTATORS:
            return _Effects(inside=not self._is_new(root(receiver), function), steady=False)
        if name in _METHODS:
            return _Effects()
        return _Effects(steady=False) if name in NEUTRAL else _UNKNOWN

    def _created(self, name: str) -> _Effects:
        """What it changes to make an instance of a class of the file."""
        program = self.program
        methods = (program.method(name, one) for one in ("__init__", "__new__", "__post_init__"))
        found = [self.of(one) for one in methods if one is not None]
        changes = any(one.anything for one in found)
        return _Effects(inside=any(one.inside for one in found), anything=changes, steady=False)

    def _of_others(self, name: str) -> _Effects:
        """What a method of this name may change, if it may belong to any class of the file."""
        program = self.program
        methods = [one for owner in program.classes for one in program.methods(owner) if one.name == name]
        if any(program.bound_to(one) == program.env for one in methods):
            return _UNKNOWN
        found = [self.of(one) for one in methods]
        inside = not all(one.harmless for one in found)
        return _Effects(
            inside=inside, anything=any(one.anything for one in found), steady=all(one.steady for one in found)
        )

    def _is_new(self, node: ast.expr, function: Function) -> bool:
        """Whether a local name always stands for a container that the function has made."""
        if not isinstance(node, ast.Name) or node.id in function.parameters:
            return False
        values = [value for value, _ in self.program.values(node, function)]
        return node.id in function.local and bool(values) and all(map(creates, values))

    def _is_number(self, node: ast.expr, function: Function) -> bool:
        """Whether a name or an attribute is somewhere bound to a number, so that += does not change an object."""
        values = (value for value, _ in self.program.values(node, function))
        return any(isinstance(value, ast.Constant) and isinstance(value.value, int | float) for value in values)


class _Walk:
    """Goes through a function and follows which names and attributes hold the same value.

    Attributes:
        found: differences and comparisons of equal values, with both values.
    """

    def __init__(self, program: Program, function: Function, reading: _Reading) -> None:
        self._program = program
        self._function = function
        self._reading = reading
        self._numbers = count()
        self.found: list[tuple[ast.expr, _Value, _Value]] = []
        written = {target.id for target, _ in function.writes if isinstance(target, ast.Name)}
        shadowed = {node.arg for node in function.nodes if isinstance(node, ast.arg)}
        inner = any(isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) for node in function.nodes)
        #: Names whose objects change, and those that functions in this one may bind.
        self._unknown = function.local if inner else written | shadowed
        names = {name: self._fresh(name, function.node) for name in function.parameters}
        self._block(function.node.body, _State(names, {}, (0, 0)))

    def _fresh(self, text: str, node: ast.AST) -> _Value:
        return _Value(next(self._numbers), text, line(node))

    def _block(self, block: list[ast.stmt], state: _State | None) -> _State | None:
        for statement in block:
            if state is None:
                return None
            state = self._statement(statement, state)
        return state

    def _statement(self, node: ast.stmt, state: _State) -> _State | None:
        """Go through a statement; None if what follows it does not run."""
        match node:
            case ast.Assign(targets=[target], value=value):
                self._assign(target, value, state)
            case ast.AnnAssign(target=target, value=ast.expr() as value):
                self._assign(target, value, state)
            case ast.If(test=test, body=body, orelse=orelse):
                self._expression(test, state)
                return self._merged([self._block(body, state.copy()), self._block(orelse, state)])
            case ast.Match(subject=subject, cases=cases):
                self._expression(subject, state)
                self._forget(node, state)
                return self._merged([state.copy(), *(self._block(case.body, state.copy()) for case in cases)])
            case ast.For() | ast.While() | ast.Try() | ast.With():
                self._around(node, state)
            case ast.Expr(value=value):
                self._expression(value, state)
            case ast.Return(value=value) | ast.Raise(exc=value):
                if isinstance(value, ast.expr) and isinstance(node, ast.Return):
                    self._expression(value, state)
                return None
            case ast.Break() | ast.Continue():
                return None
            case ast.AugAssign(value=value):
                self._expression(value, state)
                self._forget(node, state)
            case _:
                self._forget(node, state)
        return state

    def _around(self, node: ast.For | ast.While | ast.Try | ast.With, state: _State) -> None:
        """Go through the parts of a statement that may run in part, or again."""
        match node:
            case ast.For(iter=once):
                self._expression(once, state)
        self._forget(node, state)
        if isinstance(node, ast.While):
            self._expression(node.test, state)
        blocks = [getattr(node, name, []) for name in ("body", "orelse", "finalbody")]
        for block in [*blocks, *(handler.body for handler in getattr(node, "handlers", ()))]:
            self._block(block, state.copy())
        self._forget(node, state)

    def _merged(self, states: list[_State | None]) -> _State | None:
        """What is known where several ways meet."""
        known = [state for state in states if state is not None]
        if len(known) < 2:
            return known[0] if known else None
        first, *others = known
        times = [
            first.time[part] if all(one.time[part] == first.time[part] for one in others) else next(self._numbers)
            for part in (0, 1)
        ]
        merged = _State({}, {}, (times[0], times[1]))
        for name, value in first.names.items():
            if all(name in one.names and one.names[name].key == value.key for one in others):
                merged.names[name] = value
        for name in {name for one in known for name in one.fields}:
            keys = {self._field(name, one) for one in known}
            same = first.fields.get(name) if len(keys) == 1 else None
            merged.fields[name] = same or _Value(next(self._numbers), f"self.{name}", 0)
        return merged

    def _assign(self, target: ast.expr, value: ast.expr, state: _State) -> None:
        pairs = [(target, value)]
        match target, value:
            case ast.Tuple(elts=targets), ast.Tuple(elts=values) if len(targets) == len(values):
                pairs = list(zip(targets, values, strict=True))
        self._expression(value, state)
        known = [(one, self._value(given, state) or self._fresh(ast.unparse(given), one)) for one, given in pairs]
        for one, held in known:
            field = self._function.field(one)
            if isinstance(one, ast.Name):
                self._bind(one.id, held, state)
            elif field and field not in self._reading.computed:
                self._change(_Effects(writes=frozenset({field})), state)
                state.fields[field] = held
            else:
                self._forget(one, state)

    def _bind(self, name: str, value: _Value, state: _State) -> None:
        if name in self._unknown:
            value = self._fresh(name, ast.Pass())
        state.names[name] = value

    def _forget(self, node: ast.AST, state: _State) -> None:
        """Forget what a part of the function may bind or change."""
        nodes = list(ast.walk(node))
        for one in nodes:
            if isinstance(one, ast.Name) and not isinstance(one.ctx, ast.Load):
                state.names.pop(one.id, None)
            elif isinstance(one, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and one.name:
                state.names.pop(one.name, None)
        self._change(self._reading.effects(nodes, self._function), state)

    def _change(self, effects: _Effects, state: _State) -> None:
        everything, objects = state.time
        if effects.anything:
            everything = next(self._numbers)
            state.fields.clear()
        if not effects.harmless:
            objects = next(self._numbers)
        state.time = everything, objects
        # Of two equal objects, one may have changed.
        copies = {name for name, one in state.fields.items() if effects.inside and not isinstance(one.key, int)}
        for name in effects.writes | copies:
            state.fields[name] = _Value(next(self._numbers), f"self.{name}", 0)

    def _expression(self, node: ast.expr, state: _State) -> None:
        """Look for differences and comparisons in an expression, and do what it does."""
        nodes = list(ast.walk(node))
        effects = self._reading.effects(nodes, self._function)
        # Nothing is known of the order in which the parts of the expression run.
        self._change(effects, state)
        bound = {one.id for one in nodes if isinstance(one, ast.Name) and not isinstance(one.ctx, ast.Load)}
        for name in bound:
            state.names.pop(name, None)
        if not effects.harmless:
            for call in nodes:
                given = [*call.args, *(each.value for each in call.keywords)] if isinstance(call, ast.Call) else []
                for argument in given:
                    self._change_object(argument, state)
        for one in nodes:
            if isinstance(one, ast.expr) and (sides := _sides(one)) is not None:
                self._compare(one, *sides, state)
        self._change(effects, state)

    def _change_object(self, node: ast.expr, state: _State) -> None:
        """Forget the names of an object that a call may change."""
        held = root(node)
        value = state.names.get(held.id) if isinstance(held, ast.Name) else None
        if value is not None:
            for name in [name for name, one in state.names.items() if one.key == value.key]:
                del state.names[name]

    def _compare(self, node: ast.expr, left: ast.expr, right: ast.expr, state: _State) -> None:
        if not (_named(left, self._function) or _named(right, self._function)):
            return
        one, other = self._value(left, state), self._value(right, state)
        if one is not None and other is not None and one.key == other.key and ast.unparse(left) != ast.unparse(right):
            self.found.append((node, one, other))

    def _value(self, node: ast.expr, state: _State) -> _Value | None:
        """What an expression gives; None if that is not known, or a constant."""
        if isinstance(node, ast.Name):
            return state.names.get(node.id)
        text = ast.unparse(node)
        field = self._function.field(node)
        if field in state.fields:
            return state.fields[field]._replace(line=state.fields[field].line or line(node))
        nodes = list(ast.walk(node))
        effects = self._reading.effects(nodes, self._function)
        read = {one.id for one in nodes if isinstance(one, ast.Name)}
        names = sorted(read & self._function.local)
        if not effects.harmless or not effects.steady or not read.isdisjoint(self._reading.rebound):
            return None
        varies = effects.reads | {one.attr for one in nodes if isinstance(one, ast.Attribute)}
        if varies.isdisjoint(self._reading.changing) or any(name not in state.names for name in names):
            return None
        fields = tuple((name, self._field(name, state)) for name in sorted(effects.reads))
        known = tuple(state.names[name].key for name in names)
        plain = field and field not in self._reading.computed
        objects = 0 if plain else state.time[1]
        return _Value((text, known, fields, objects), text, line(node))

    def _field(self, name: str, state: _State) -> Hashable:
        return state.fields[name].key if name in state.fields else (name, state.time[0])
