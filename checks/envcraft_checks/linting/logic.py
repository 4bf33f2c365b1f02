"""Conditions that can never hold, and arithmetic that depends on chance."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator
from functools import cached_property

from .program import Function, Program, Suspect, line, name_of

_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
}
_MIRRORED = {ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE, ast.Eq: ast.Eq}
#: Words of names that end or decide an episode.
_ENDS = ("done", "game_over", "gameover", "lost", "success", "terminat", "truncat", "victory", "win", "won")
_ROOTS = frozenset({"dist", "hypot", "norm", "sqrt"})


def contradictions(program: Program) -> Iterator[Suspect]:
    """Find tests of the end that can never be true."""
    ranges = _Ranges(program)
    for function in program.play:
        if program.bound_to(function) != program.env:
            continue
        for node in function.nodes:
            if isinstance(node, ast.BoolOp) and _holds_false(node) and _decides(program, node):
                yield Suspect(line(node), f"tests {ast.unparse(node)[:60]}, which is never true")
            if isinstance(node, ast.Compare) and len(node.ops) == 1 and _decides(program, node):
                for field_side, other, kind in (
                    (node.left, node.comparators[0], type(node.ops[0])),
                    (node.comparators[0], node.left, _MIRRORED.get(type(node.ops[0]))),
                ):
                    field, limit = function.field(field_side), ranges.constant(other, function)
                    if field and limit is not None and kind is not None:
                        low, high = ranges.of(field)
                        if _never(kind, low, high, limit):
                            below = kind in (ast.Gt, ast.GtE) or high < limit
                            bound = f"is never above {high:g}" if below else f"is never below {low:g}"
                            yield Suspect(line(node), f"tests {ast.unparse(node)}, but self.{field} {bound}")
    yield from _never_set(program)


def _holds_false(node: ast.BoolOp) -> bool:
    return isinstance(node.op, ast.And) and any(map(_is_false, node.values))


def _never_set(program: Program) -> Iterator[Suspect]:
    """Find flags of success that play reads, and that nothing ever makes true."""
    own = program.methods(program.env)
    foreign = {
        node.attr
        for node in program.nodes
        if isinstance(node, ast.Attribute)
        and isinstance(node.ctx, ast.Store)
        and not any(one.field(node) for one in own)
    }
    for field, values in program.field_values(program.env).items():
        named = not {"success", "victory", "win", "won"}.isdisjoint(field.lower().split("_"))
        if not named or field in foreign or not all(_is_false(value) for value, _ in values):
            continue
        for function in program.play:
            for node in function.nodes:
                if function.field(node) == field and isinstance(getattr(node, "ctx", None), ast.Load):
                    yield Suspect(line(node), f"reads self.{field}, which nothing ever makes true")


def _is_false(node: ast.AST | None) -> bool:
    return isinstance(node, ast.Constant) and node.value is False


def _never(kind: type[ast.cmpop], low: float, high: float, limit: float) -> bool:
    if kind is ast.GtE:
        return high < limit
    if kind is ast.Gt:
        return high <= limit
    if kind is ast.LtE:
        return low > limit
    if kind is ast.Lt:
        return low >= limit
    return kind is ast.Eq and (high < limit or low > limit)


def _decides(program: Program, test: ast.AST) -> bool:
    """Whether a test decides how an episode ends."""
    node = test
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
        if isinstance(node, ast.IfExp | ast.comprehension | ast.UnaryOp):
            return False
    if isinstance(node, ast.If):
        if test not in set(ast.walk(node.test)):
            return False
        bound = [name_of(target) for one in node.body if isinstance(one, ast.Assign) for target in one.targets]
    elif isinstance(node, ast.Assign):
        bound = [name_of(target) for target in node.targets]
    else:
        return False
    return any(word in name.lower() for name in bound for word in _ENDS)


class _Ranges:
    """The values that attributes of the environment can have, as far as constants say."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.methods = program.methods(program.env)
        self._known: dict[str, tuple[float, float]] = {}
        foreign = (
            node
            for node in program.nodes
            if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del)
        )
        mine = {target for one in self.methods for target in one.nodes if one.field(target)}
        #: Attributes that something else than a method of the environment assigns.
        self._foreign = {node.attr for node in foreign if node not in mine}
        self._set = any(name_of(node) in ("setattr", "__dict__") for one in self.methods for node in one.nodes)

    def of(self, field: str) -> tuple[float, float]:
        """The lowest and the highest value of an attribute between two calls."""
        if field not in self._known:
            # While it is looked for, it adds nothing to itself: what is assigned first bounds what is made of it.
            self._known[field] = math.inf, -math.inf
            self._known[field] = self._judge(field)
        return self._known[field]

    def _judge(self, field: str) -> tuple[float, float]:
        if self._set or field in self._foreign:
            return -math.inf, math.inf
        ranges = []
        for method in self.methods:
            for target, value, statement in method.bindings:
                if method.field(target) == field and not self._settled(statement, field, method):
                    ranges.append(self.range(value, method))
            for node in method.nodes:
                if (
                    isinstance(node, ast.AugAssign)
                    and method.field(node.target) == field
                    and not self._settled(node, field, method)
                ):
                    ranges.append(self._moved((math.inf, -math.inf), node.op, node.value, method))
        known = self.program.class_values(self.program.env)
        if field in known:
            ranges.append(self.range(known[field][1], None))
        low = min((low for low, _ in ranges), default=math.inf)
        high = max((high for _, high in ranges), default=-math.inf)
        if high == math.inf:
            high = self._gained(field)
        return (low, high) if low <= high else (-math.inf, math.inf)

    def _gained(self, field: str) -> float:
        """The most that a sum of constants can reach before the step limit, infinity if nothing limits it."""
        total, limit = 0.0, self._limit
        for method in self.methods:
            for target, value, _ in method.bindings:
                if method.field(target) == field and (start := self.constant(value, method)) is None:
                    return math.inf
                if method.field(target) == field:
                    total = max(total, start or 0.0)
        for method in self.methods:
            for node in method.nodes:
                if isinstance(node, ast.AugAssign) and method.field(node.target) == field:
                    step = self.constant(node.value, method)
                    if step is None or not isinstance(node.op, ast.Add | ast.Sub) or not self._once(node, method):
                        return math.inf
                    total += limit * max(step if isinstance(node.op, ast.Add) else -step, 0.0)
        return total

    @cached_property
    def _limit(self) -> float:
        """The number of steps after which an episode ends, as a counter in step() says; infinity if none does."""
        step = self.program.method(self.program.env, "step")
        limits = [math.inf]
        for node in step.node.body if step is not None else ():
            if step is None or not isinstance(node, ast.AugAssign) or not isinstance(node.op, ast.Add):
                continue
            field = step.field(node.target)
            if self.constant(node.value, step) != 1 or not self._counts_steps(field):
                continue
            for test in (one for method in self.methods for one in method.nodes if isinstance(one, ast.Compare)):
                owner = next(method for method in self.methods if test in method.nodes)
                end = self.constant(test.comparators[0], owner)
                compared = isinstance(test.ops[0], ast.GtE | ast.Gt | ast.Eq) and owner.field(test.left) == field
                if compared and end is not None and len(test.ops) == 1 and _decides(self.program, test):
                    limits.append(end + 1 if self._unconditional(test, owner) else math.inf)
        # The latest of several ends, since some may hold only on a condition.
        return max(limits[1:], default=math.inf)

    def _unconditional(self, test: ast.AST, method: Function) -> bool:
        """Whether a test holds whatever else is true, unless the episode has ended in another way."""
        node = test
        while node is not method.node:
            node, child = self.program.parents[node], node
            if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.And):
                others = [one for one in node.values if one is not child]
                if not all(isinstance(one, ast.UnaryOp) and isinstance(one.op, ast.Not) for one in others):
                    return False
            if isinstance(node, ast.For | ast.While) or (isinstance(node, ast.If) and child in node.body):
                return False
        return True

    def _counts_steps(self, field: str) -> bool:
        """Whether an attribute is 0 at the reset, and changes only by one addition in step()."""
        resetting = self.program.reached("step")
        added = [one for method in self.methods for one, _ in method.writes if method.field(one) == field]
        values = self.program.field_values(self.program.env).get(field, [])
        zero = all(self.constant(value, method) == 0 and method not in resetting for value, method in values)
        return bool(values) and zero and len(added) == 1 and field not in self._foreign

    def _once(self, node: ast.AST, method: Function, depth: int = 8) -> bool:
        """Whether a step runs a statement at most once: no loop holds it, nor the only call of its method."""
        while node is not method.node:
            node = self.program.parents[node]
            if isinstance(node, ast.For | ast.While | ast.comprehension | ast.ListComp | ast.GeneratorExp | ast.Lambda):
                return False
        if method.name == "step":
            return True
        calls = [
            (one, caller)
            for caller in self.program.reached("step")
            for one in caller.nodes
            if isinstance(one, ast.Attribute) and one.attr == method.name
        ]
        return depth > 0 and len(calls) == 1 and self._once(*calls[0], depth - 1)

    def _moved(
        self, start: tuple[float, float], op: ast.operator, by: ast.AST, method: Function | None
    ) -> tuple[float, float]:
        """The range of a sum or a difference with a constant; a value that is added to itself has no bound there."""
        step = self.constant(by, method)
        if step is None or not isinstance(op, ast.Add | ast.Sub):
            return -math.inf, math.inf
        step = step if isinstance(op, ast.Add) else -step
        low, high = start
        if low > high:
            return (low, math.inf if step > 0 else high) if step >= 0 else (-math.inf, high)
        return low + step, high + step

    def _settled(self, statement: ast.AST, field: str, method: Function) -> bool:
        """Whether the next statement clips what this statement assigns."""
        for block in (getattr(self.program.parents[statement], name, ()) for name in ("body", "orelse")):
            if isinstance(block, list) and statement in block[:-1]:
                match block[block.index(statement) + 1]:
                    case ast.Assign(targets=[target], value=value) if method.field(target) == field:
                        return max(map(abs, self.range(value, method))) < math.inf
        return False

    def range(self, node: ast.AST | None, method: Function | None) -> tuple[float, float]:
        """The lowest and the highest value of an expression."""
        everything = (-math.inf, math.inf)
        if (value := self.constant(node, method)) is not None:
            return value, value
        match node:
            case ast.Call(func=ast.Name(id="min" | "max" as name), args=args, keywords=[]) if len(args) > 1:
                parts = [self.range(one, method) for one in args]
                pick = min if name == "min" else max
                return pick(low for low, _ in parts), pick(high for _, high in parts)
            case ast.Call(func=ast.Attribute(attr="clip"), args=[_, low, high]):
                return self.range(low, method)[0], self.range(high, method)[1]
            case ast.Call(func=ast.Name(id="int" | "float" | "round"), args=[one]):
                return self.range(one, method)
            case ast.BinOp(op=ast.Mod(), right=right):
                modulus = self.constant(right, method)
                return (0, modulus) if modulus is not None and modulus > 0 else everything
            case ast.BinOp(left=left, op=op, right=right):
                return self._moved(self.range(left, method), op, right, method)
            case ast.Attribute() if method is not None and method.field(node) in self._known:
                return self._known[method.field(node)]
            case ast.IfExp(body=body, orelse=orelse):
                first, second = self.range(body, method), self.range(orelse, method)
                return min(first[0], second[0]), max(first[1], second[1])
        return everything

    def constant(self, node: ast.AST | None, method: Function | None) -> float | None:
        """The value of an expression of numbers, and of names that are bound once."""
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return value
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                positive = self.constant(operand, method)
                return None if positive is None else -positive
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                first, second = self.constant(left, method), self.constant(right, method)
                if first is None or second is None or (second == 0 and isinstance(op, ast.Div | ast.FloorDiv)):
                    return None
                return float(_OPERATORS[type(op)](first, second))
            case ast.Name() | ast.Attribute():
                values = self.program.values(node, method)
                if len(values) == 1 and not self._changes(node, method):
                    return self.constant(*values[0])
        return None

    def _changes(self, node: ast.AST, method: Function | None) -> bool:
        name = name_of(node)
        if method is not None and method.field(node):
            return name in self._foreign or any(
                one.field(target) == name for one in self.methods for target, _ in one.writes
            )
        # A name of the module is constant if it is written like one.
        return not name.isupper()


def floats(program: Program) -> Iterator[Suspect]:
    """Find tests of the end that compare a sum of fractions with ``==``."""
    for function in program.play:
        for node in function.nodes:
            if isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.Eq) and _decides(program, node):
                for side, other in ((node.left, node.comparators[0]), (node.comparators[0], node.left)):
                    exact = isinstance(other, ast.Constant) and not isinstance(other.value, int | float)
                    if not exact and (field := function.field(side)) and _fraction(program, function, field):
                        yield Suspect(line(node), f"compares a sum of fractions exactly: {ast.unparse(node)}")


def _fraction(program: Program, function: Function, field: str) -> bool:
    """Whether an attribute is a running sum of fractions, and nothing rounds or clips it."""
    methods = program.methods(program.bound_to(function))
    adds = any(
        isinstance(node, ast.AugAssign)
        and isinstance(node.op, ast.Add | ast.Sub)
        and one.field(node.target) == field
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, float)
        and not (node.value.value * 1024).is_integer()
        for one in methods
        for node in one.nodes
    )
    values = [value for one in methods for target, value, _ in one.bindings if one.field(target) == field]
    return adds and all(isinstance(value, ast.Constant) for value in values)


def divisions(program: Program) -> Iterator[Suspect]:
    """Find divisions by a length or a distance that nothing compares with zero."""
    for function in program.play:
        tests = _tests(function)
        for node in function.nodes:
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div | ast.FloorDiv | ast.Mod):
                what = _may_be_zero(program, function, node.right)
                if what and not any(word in test for word in what for test in tests):
                    yield Suspect(line(node), f"divides by {ast.unparse(node.right)[:40]}, which may be zero")


def _tests(function: Function) -> list[str]:
    """The text of whatever the function tests or iterates over."""
    found: list[ast.AST] = []
    for node in function.nodes:
        match node:
            case ast.If(test=test) | ast.While(test=test) | ast.IfExp(test=test) | ast.Assert(test=test):
                found.append(test)
            case ast.BoolOp():
                found.append(node)
            case ast.For(iter=iterated) | ast.comprehension(iter=iterated):
                found.append(iterated)
            case ast.Try():
                found += [handler.type for handler in node.handlers if handler.type is not None]
    return [ast.unparse(one) for one in found]


def _may_be_zero(program: Program, function: Function, divisor: ast.expr) -> tuple[str, ...]:
    """The texts one of which a test must contain, if a divisor is a length or a distance."""
    if isinstance(divisor, ast.Name):
        values = program.values(divisor, function)
        if (
            len(values) == 1
            and values[0][0] is not None
            and not isinstance(values[0][0], ast.Name)
            and (inner := _may_be_zero(program, function, values[0][0]))
        ):
            return divisor.id, *inner
    if (
        isinstance(divisor, ast.Call)
        and name_of(divisor) in _ROOTS
        and program.path(divisor.func, function).startswith(("math.", "numpy."))
    ):
        return (ast.unparse(divisor), "ZeroDivisionError")
    match divisor:
        case ast.Call(func=ast.Name(id="len"), args=[one]) if function.field(one) and _empties(
            program, function, function.field(one)
        ):
            return (ast.unparse(one), "ZeroDivisionError")
    return ()


def _empties(program: Program, function: Function, field: str) -> bool:
    """Whether play takes items out of an attribute."""
    return any(
        isinstance(node, ast.Call) and name_of(node) in ("clear", "discard", "pop", "popitem", "popleft", "remove")
        for one in program.play
        for target, node in one.writes
        if one.field(target) == field and program.bound_to(one) == program.bound_to(function)
    )
