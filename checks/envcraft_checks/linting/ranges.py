"""Between which values an attribute stays, as far as constants and the step limit say."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator
from functools import cached_property

from .lengths import Lengths
from .program import Function, Program, name_of

_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
}
#: Larger numbers are left alone.
_LARGEST = 1e15
#: Words of names that end or decide an episode: whole ones, and parts of some.
_WORDS = frozenset({"done", "lost", "over", "win", "wins", "won"})
_PARTS = ("gameover", "success", "terminat", "truncat", "victory")


def decides(program: Program, test: ast.AST) -> bool:
    """Whether a test decides how an episode ends."""
    node = test
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
        if isinstance(node, ast.IfExp | ast.comprehension | ast.UnaryOp):
            return False
    if isinstance(node, ast.If):
        if test not in set(ast.walk(node.test)):
            return False
        assigned = [one for one in node.body if isinstance(one, ast.Assign)]
        bound = [name_of(target) for one in assigned for target in one.targets]
        # A state such as "won" or State.WON says so, too.
        bound += [
            str(one.value.value) if isinstance(one.value, ast.Constant) else name_of(one.value) for one in assigned
        ]
    elif isinstance(node, ast.Assign):
        bound = [name_of(target) for target in node.targets]
    else:
        return False
    return any(map(names_end, bound))


def names_end(name: str) -> bool:
    """Whether the name of a variable or a method says that it ends or decides an episode."""
    name = name.lower()
    return any(part in name for part in _PARTS) or not _WORDS.isdisjoint(name.split("_"))


#: The longest chain of names that lead to a number.
_CHAIN = 20


class Ranges:
    """The values that attributes of the environment can have, as far as constants say."""

    def __init__(self, program: Program) -> None:
        self.program = program
        self.methods = program.methods(program.env)
        self.lengths = Lengths(program, self.constant)
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
        changes: list[tuple[ast.expr | None, ast.AST, Function]] = []
        for method in self.methods:
            bound = [(value, node, method) for target, value, node in method.bindings if method.field(target) == field]
            added = [node for node in method.nodes if isinstance(node, ast.AugAssign)]
            changes += [*bound, *((node.value, node, method) for node in added if method.field(node.target) == field)]
        last = [(value, node, method) for value, node, method in changes if not self._settled(node, field, method)]
        if len(last) < len(changes):
            # What is clipped next may be anything before.
            self._known[field] = -math.inf, math.inf
        ranges = [
            self._moved((math.inf, -math.inf), node.op, value, method)
            if isinstance(node, ast.AugAssign) and value is not None
            else self.range(value, method)
            for value, node, method in last
        ]
        known = self.program.class_values(self.program.env)
        if field in known:
            ranges.append(self.range(known[field][1], None))
        low = min((low for low, _ in ranges), default=math.inf)
        high = max((high for _, high in ranges), default=-math.inf)
        if high == math.inf:
            high = min(self._gained(field), self.lengths.counted(field))
        return (low, high) if low <= high else (-math.inf, math.inf)

    def _gained(self, field: str) -> float:
        """The most that a sum of constants can reach before the step limit, infinity if nothing limits it."""
        total, limit = 0.0, self._limit
        added: list[tuple[ast.operator, ast.expr, ast.AST, Function]] = []
        for method in self.methods:
            for target, value, statement in method.bindings:
                for part in _choices(value) if method.field(target) == field else ():
                    if isinstance(part, ast.BinOp) and method.field(part.left) == field:
                        added.append((part.op, part.right, statement, method))
                        continue
                    if (start := self.constant(part, method)) is None:
                        return math.inf
                    total = max(total, start)
            for node in method.nodes:
                if isinstance(node, ast.AugAssign) and method.field(node.target) == field:
                    added.append((node.op, node.value, node, method))
        for op, value, node, method in added:
            step = self.constant(value, method)
            if step is None or not isinstance(op, ast.Add | ast.Sub) or not self._once(node, method):
                return math.inf
            total += limit * max(step if isinstance(op, ast.Add) else -step, 0.0)
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
                if compared and end is not None and len(test.ops) == 1 and decides(self.program, test):
                    limits.append(end + 1 if self._unconditional(test, owner) else math.inf)
        # The latest of several ends, since some may hold only on a condition.
        return max(limits[1:], default=math.inf)

    def _unconditional(self, test: ast.AST, method: Function) -> bool:
        """Whether a test holds under all other conditions, unless the episode has ended in another way."""
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
        loops = (ast.For, ast.While, ast.comprehension, ast.ListComp, ast.GeneratorExp, ast.Lambda)
        if any(isinstance(each, loops) for each in self.program.around(node, method)):
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
        """Whether the next statement, or the next one after a choice of branches, clips what this one assigns."""
        following: list[ast.stmt] = []
        while isinstance(statement, ast.stmt) and not following:
            block = self.program.block(statement)
            following = block[block.index(statement) + 1 :] if block else []
            statement = self.program.parents[statement]
            if not isinstance(statement, ast.If):
                break
        match following:
            case [ast.Assign(targets=[target], value=value), *_] if method.field(target) == field:
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
            case ast.Call(func=ast.Name(id="len"), args=[items]) if method is not None:
                return 0, self.lengths.of(items, method)
            case ast.Call(func=ast.Name(id="sum"), args=[ast.GeneratorExp() | ast.ListComp() as items]) if method:
                return (0, self.lengths.of(items, method)) if _is_bool(items.elt) else everything
            case ast.Call(func=ast.Name(id="sum"), args=[ast.Attribute() as items]) if method and method.field(items):
                flags = self.lengths.are_flags(method.field(items))
                return (0, self.lengths.of(items, method)) if flags else everything
            case ast.Call() if method is not None and (called := self.program.called(node, method)) is not None:
                return self._returned(called)
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

    def _returned(self, function: Function) -> tuple[float, float]:
        """The range of the result of a method that only returns one."""
        match function.node.body[-1:]:
            case [ast.Return(value=ast.Call() as value)] if name_of(value.func) in ("int", "len", "sum"):
                others = [node for node in function.nodes if isinstance(node, ast.Return)]
                return self.range(value, function) if len(others) == 1 else (-math.inf, math.inf)
        return -math.inf, math.inf

    def constant(self, node: ast.AST | None, method: Function | None, depth: int = _CHAIN) -> float | None:
        """The value of an expression of numbers, and of names that are bound once."""
        match node:
            case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
                return value if abs(value) < _LARGEST else None
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                positive = self.constant(operand, method, depth)
                return None if positive is None else -positive
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                first, second = self.constant(left, method, depth), self.constant(right, method, depth)
                if first is None or second is None or (second == 0 and isinstance(op, ast.Div | ast.FloorDiv)):
                    return None
                result = _OPERATORS[type(op)](first, second)
                return result if abs(result) < _LARGEST else None
            case ast.Name() | ast.Attribute():
                values = self.program.values(node, method)
                if depth and len(values) == 1 and not self.changes(node, method):
                    return self.constant(*values[0], depth - 1)
        return None

    def numbers(self, node: ast.AST | None, method: Function | None, depth: int = 3) -> set[float]:
        """The numbers that an expression may be; none if they are not known."""
        if (number := self.constant(node, method)) is not None:
            return {number}
        parts: list[tuple[ast.AST | None, Function | None]] = []
        match node:
            case ast.IfExp(body=body, orelse=orelse):
                parts = [(body, method), (orelse, method)]
            case ast.Name(id=name) if method is not None and name in method.local and name not in method.parameters:
                if not any(isinstance(target, ast.Name) and target.id == name for target, _ in method.writes):
                    parts = [(value, method) for value, _ in self.program.values(node, method)]
            case ast.Attribute(attr=attr) if method is not None and not method.field(node):
                # The attribute of another object, such as of an enemy.
                parts = [*self._elsewhere(attr)]
            case ast.Attribute() if method is not None and not self.changes(node, method):
                parts = [(value, method) for value, _ in self.program.values(node, method)]
            case ast.Subscript():
                parts = [(one, method) for one in self._items(node, method)]
        found = [self.numbers(one, owner, depth - 1) if depth else set() for one, owner in parts]
        return set().union(*found) if all(found) else set()

    def _items(self, node: ast.Subscript, method: Function | None) -> list[ast.expr]:
        """The expressions in a table that a subscript may be, such as ``WEIGHTS[kind]`` or ``FISH[kind][0]``."""
        match node.value:
            case ast.Subscript() as row:
                tables: list[ast.expr] = self._items(row, method)
            case ast.Name() | ast.Attribute() as name:
                values = [value for value, _ in self.program.values(name, method)]
                known = len(values) == 1 and not self.changes(name, method)
                # A list may change under another name, unless it is written like a constant.
                tables = [
                    value
                    for value in values
                    if known and value is not None and (isinstance(value, ast.Tuple) or name_of(name).isupper())
                ]
            case table:
                tables = [table]
        found: list[ast.expr] = []
        owned = method is not None and bool(method.field(node.slice))
        key = node.slice.value if isinstance(node.slice, ast.Constant) else self.constant(node.slice, method)
        for table in tables:
            if isinstance(node.slice, ast.Slice) or not isinstance(table, ast.Tuple | ast.List | ast.Dict):
                return []
            items = table.values if isinstance(table, ast.Dict) else table.elts
            if key is None:
                # A member of an enum, a limited index or a turn is not any item.
                other = isinstance(node.slice, ast.Attribute) and not owned
                turn = isinstance(node.slice, ast.BinOp) and method is not None and bool(method.field(node.slice.left))
                if other or turn or name_of(node.slice) in ("clip", "max", "min"):
                    return []
                found += items
            elif isinstance(table, ast.Dict):
                pairs = zip(table.keys, items, strict=True)
                found += [item for one, item in pairs if isinstance(one, ast.Constant) and one.value == key]
            elif isinstance(key, int) and -len(items) <= key < len(items):
                found.append(items[key])
            else:
                return []
        return found

    def _elsewhere(self, name: str) -> Iterator[tuple[ast.AST | None, Function | None]]:
        """What any code of the file gives an attribute of this name; None for an unknown value."""
        for function in self.program.all:
            for target, value, _ in function.bindings:
                if isinstance(target, ast.Attribute) and target.attr == name:
                    yield value, function
            if any(isinstance(target, ast.Attribute) and target.attr == name for target, _ in function.writes):
                yield None, None
        for node in self.program.nodes:
            if isinstance(node, ast.keyword) and node.arg == name:
                yield node.value, None
            elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == name:
                # Arguments without a name may set the field of a dataclass.
                yield None, None

    def changes(self, node: ast.AST, method: Function | None) -> bool:
        name = name_of(node)
        if method is not None and method.field(node):
            return name in self._foreign or any(
                one.field(target) == name for one in self.methods for target, _ in one.writes
            )
        # A name of the module is constant if it is written like one.
        return not name.isupper()


def _choices(value: ast.expr | None) -> list[ast.expr | None]:
    """The values of which an expression is one."""
    return [*_choices(value.body), *_choices(value.orelse)] if isinstance(value, ast.IfExp) else [value]


def _is_bool(node: ast.expr) -> bool:
    """Whether an expression is True or False, or the number 1."""
    if isinstance(node, ast.Constant):
        return node.value == 1
    return isinstance(node, ast.Compare) or (isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not))
