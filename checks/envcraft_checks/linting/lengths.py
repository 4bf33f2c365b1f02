"""The most items that a list of the environment holds, and the most that play can count of them."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterator

from .program import MUTATORS, Function, Program

#: What gives a number: the constant value of an expression, None if it is not known.
_Constant = Callable[[ast.AST | None, Function | None], float | None]
_TAKERS = frozenset({"discard", "pop", "popleft", "remove"})
_ENDERS = _TAKERS - {"discard"}
_ADDERS = frozenset({"add", "append", "appendleft"})
#: Functions of Python that keep no reference to their argument, and those that copy its items.
_READERS = frozenset({"all", "any", "bool", "enumerate", "len", "max", "min", "reversed", "str", "sum", "zip"})
_COPIES = frozenset({"array", "asarray", "deque", "enumerate", "list", "reversed", "set", "sorted", "tuple"})
_DRAWN = frozenset({"choice", "integers", "normal", "permutation", "random", "uniform"})
_FILLED = frozenset({"empty", "full", "ones", "zeros"})
_FINDERS = frozenset({"argwhere", "count_nonzero", "flatnonzero", "nonzero"})
_JOINING = frozenset({"concatenate", "hstack", "stack", "vstack"})
_DEPTH = 4


class Lengths:
    """How many items the attributes of the environment hold, as far as the code of a reset says.

    Args:
        program: the file.
        constant: gives the value of an expression.
    """

    def __init__(self, program: Program, constant: _Constant) -> None:
        self._program = program
        self._constant = constant
        self._play = [each for each in program.reached("step") if program.bound_to(each) == program.env]
        self._methods = program.methods(program.env)

    def most(self, field: str, depth: int = _DEPTH) -> float:
        """The most items of an attribute to which play adds none; infinity if it is not known."""
        if not depth or not self._is_private(field):
            return math.inf
        lengths = []
        for method in self._methods:
            for target, value, _ in method.bindings:
                if method.field(target) == field and not _shrinks(value, field, method):
                    lengths.append(math.inf if method in self._play else self.of(value, method, depth - 1))
        return max(lengths, default=math.inf) + sum(self._added(field))

    def counted(self, counter: str) -> float:
        """The most that an attribute counts if each time it takes an item for good; infinity if it is not known."""
        lists: set[str] = set()
        if not self._is_reset(counter):
            return math.inf
        for method in self._methods:
            for target, value, _ in method.bindings:
                if method.field(target) == counter and self._constant(value, method) != 0:
                    return math.inf
            for target, node in method.writes:
                if method.field(target) == counter:
                    taken = self._taken(node, method)
                    if not taken:
                        return math.inf
                    lists.add(taken)
        return self.most(lists.pop()) if len(lists) == 1 else math.inf

    def _is_reset(self, field: str) -> bool:
        """Whether reset() gives an attribute a first value, itself or in a method."""
        return any(
            method.field(target) == field
            for method in self._program.reached("reset")
            if method not in self._play
            for target, _, _ in method.bindings
        )

    def of(self, node: ast.AST | None, method: Function, depth: int = _DEPTH) -> float:
        """The most items of an expression; infinity if it is not known."""
        match node:
            case ast.List(elts=elts) | ast.Tuple(elts=elts) | ast.Set(elts=elts):
                return math.inf if any(isinstance(each, ast.Starred) for each in elts) else len(elts)
            case ast.ListComp(generators=parts) | ast.SetComp(generators=parts) | ast.GeneratorExp(generators=parts):
                return math.prod(self.of(part.iter, method, depth) for part in parts)
            case ast.BinOp(left=ast.List() as items, op=ast.Mult(), right=times):
                return self._times(self.of(items, method, depth), times, method)
            case ast.Compare(left=left, comparators=[ast.Constant()]):
                return self.of(left, method, depth)
            case ast.Call(func=ast.Attribute(attr=name), args=[ast.List(elts=parts), *_]) if name in _JOINING:
                return sum(self.of(part, method, depth) for part in parts)
            case ast.Call(func=ast.Name(id="range"), args=[end]):
                return self._times(1, end, method)
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[inner, *_]) if name in _COPIES:
                return self.of(inner, method, depth)
            case ast.Call(func=ast.Attribute(attr=name), args=[first, *more], keywords=keywords) if name in _DRAWN:
                size = next((each.value for each in keywords if each.arg == "size"), None)
                place = {"random": 0, "permutation": 0, "choice": 1, "integers": 2}.get(name, math.inf)
                size = size or next((each for at, each in enumerate([first, *more]) if at == place), None)
                return self._times(1, size, method)
            case ast.Call(func=ast.Attribute(attr=name), args=[size, *_]) if name in _FILLED:
                return self._times(1, size, method)
            case ast.Subscript(value=value, slice=ast.Tuple(elts=parts)) if all(
                isinstance(each, ast.Slice) for each in parts
            ):
                return self.of(value, method, depth)
            case ast.Subscript(slice=ast.Slice(lower=lower, upper=ast.expr() as upper, step=None)):
                low, high = self._constant(lower, method) if lower else 0, self._constant(upper, method)
                return high - low if low is not None and high is not None and 0 <= low <= high else math.inf
            case ast.Name(id=name) if name in method.local and depth:
                changed = any(isinstance(target, ast.Name) and target.id == name for target, _ in method.writes)
                values = [] if changed else self._program.values(node, method)
                return max((self.of(value, method, depth - 1) for value, _ in values), default=math.inf)
            case ast.Attribute() if depth and (field := method.field(node)):
                return self.most(field, depth - 1)
        return math.inf

    def are_flags(self, field: str) -> bool:
        """Whether all items of an attribute are True or False, or arrays of these."""
        if not self._is_private(field):
            return False
        for method in self._methods:
            for target, value, _ in method.bindings:
                if method.field(target) == field and not _are_flags(value, method):
                    return False
            for target, node in method.writes:
                if method.field(target) == field and not isinstance(_stored(self._program.parents[node]), bool):
                    return False
        return True

    def _times(self, items: float, times: ast.AST | None, method: Function) -> float:
        if isinstance(times, ast.Call) and isinstance(times.func, ast.Name) and times.func.id == "len" and times.args:
            return items * self.of(times.args[0], method)
        if isinstance(times, ast.Tuple) and times.elts:
            return math.prod([items, *(self._times(1, each, method) for each in times.elts)])
        number = self._constant(times, method)
        return items * number if number is not None and number >= 0 else math.inf

    def _added(self, field: str) -> Iterator[float]:
        """How many items each place adds that writes into an attribute; infinity if it is not known."""
        for method in self._methods:
            for target, node in method.writes:
                if method.field(target) != field:
                    continue
                if isinstance(node, ast.Subscript):
                    if isinstance(node.slice, ast.Slice) and isinstance(node.ctx, ast.Store):
                        yield math.inf
                    continue
                name = node.func.attr if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) else ""
                if name in _ADDERS:
                    # Another method may be called several times, and a list without a first value there grows.
                    once = method.name == "reset" and any(
                        method.field(bound) == field for bound, _, _ in method.bindings
                    )
                    yield self._repeated(node, method) if once else math.inf
                elif name not in _TAKERS | {"clear", "reverse", "rotate", "sort"}:
                    yield math.inf

    def _repeated(self, node: ast.AST, method: Function) -> float:
        """How often one call of a method runs a statement."""
        times = 1.0
        for each in self._program.around(node, method):
            if isinstance(each, ast.For):
                times *= self.of(each.iter, method)
            elif isinstance(each, ast.While | ast.comprehension | ast.Lambda):
                return math.inf
        return times

    def _is_private(self, field: str) -> bool:
        """Whether only methods of the environment use the object of an attribute, under no other name."""
        mine = {node for method in self._methods for node in method.nodes if method.field(node) == field}
        for node in self._program.nodes:
            if not isinstance(node, ast.Attribute) or node.attr != field:
                continue
            if node not in mine or not _is_read(node, self._program.parents[node]):
                return False
        return True

    def _taken(self, node: ast.AST, method: Function) -> str:
        """The attribute from which the statements beside one that counts take an item for good, "" if none does."""
        counts = isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add)
        if not counts or not isinstance(node, ast.AugAssign) or self._constant(node.value, method) != 1:
            return ""
        parent = self._program.parents[node]
        for each in self._program.block(node):
            match each:
                case ast.Expr(value=ast.Call(func=ast.Attribute(value=held, attr=attr))) if attr in _ENDERS:
                    field = method.field(held)
                case ast.Assign(
                    targets=[ast.Subscript() | ast.Attribute() as place], value=ast.Constant(value=bool() as value)
                ) if self._is_first(place, value, parent, method):
                    field = self._holder(place, each, method)
                case _:
                    continue
            if field:
                return field
        return ""

    def _holder(self, place: ast.Subscript | ast.Attribute, node: ast.AST, method: Function) -> str:
        """The attribute of which a place is an item, or a part of an item over which a loop goes."""
        if field := method.field(place.value):
            return field
        for each in self._program.around(node, method):
            if isinstance(each, ast.For):
                items, iterated = each.target, each.iter
                if isinstance(iterated, ast.Call) and getattr(iterated.func, "id", "") == "enumerate":
                    items, iterated = getattr(items, "elts", [items])[-1], iterated.args[0]
                if isinstance(items, ast.Name) and isinstance(place.value, ast.Name) and items.id == place.value.id:
                    return method.field(iterated)
        return ""

    def _is_first(self, place: ast.Subscript | ast.Attribute, value: bool, parent: ast.AST, method: Function) -> bool:
        """Whether a test says that a place does not have its new value yet, and play never gives it the old one."""
        text = ast.unparse(place)
        before = text if not value else f"not {text}"
        tests = _left_behind(place, parent)
        for each in self._program.around(place, method):
            tests += _parts(each.test) if isinstance(each, ast.If) else []
        return any(ast.unparse(test) == before for test in tests) and all(
            _stored(self._program.parents[node]) is value
            for each in self._play
            for node in each.nodes
            if _is_alike(node, place, each, method)
        )


def _parts(test: ast.expr) -> list[ast.expr]:
    """The tests that all hold where a test does."""
    return test.values if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And) else [test]


def _left_behind(place: ast.AST, parent: ast.AST) -> list[ast.expr]:
    """The tests without which the block of a place is left before it."""
    found: list[ast.expr] = []
    for statement in getattr(parent, "body", []):
        match statement:
            case ast.If(test=ast.UnaryOp(op=ast.Not(), operand=test), body=[ast.Return()], orelse=[]):
                found += _parts(test)
            case _ if any(node is place for node in ast.walk(statement)):
                return found
    return []


def _is_alike(node: ast.AST, place: ast.Subscript | ast.Attribute, function: Function, method: Function) -> bool:
    """Whether a statement may write a place of this kind: the same key or attribute, or an item of the same list."""
    if type(node) is not type(place) or not isinstance(getattr(node, "ctx", None), ast.Store):
        return False
    match node, place:
        case ast.Attribute(attr=one), ast.Attribute(attr=other):
            return one == other
        case ast.Subscript(value=one, slice=key), ast.Subscript(value=other, slice=own):
            if field := method.field(other):
                return function.field(one) == field
            return ast.unparse(key) == ast.unparse(own)
    return False


def _is_read(node: ast.Attribute, parent: ast.AST) -> bool:
    """Whether the object of an attribute has no other name after an expression, or whether the attribute is bound."""
    match parent:
        case ast.Attribute(attr=attr):
            return attr in MUTATORS | {"all", "any", "copy", "count", "index", "max", "min", "size", "sum", "tolist"}
        case ast.Call(func=ast.Attribute(value=ast.Name(id="np" | "numpy"), attr=name)) if name in _FINDERS:
            return True
        case ast.Call(func=ast.Name(id=name)):
            return name in _READERS | _COPIES
        case ast.Assign(targets=targets):
            return node in targets
        case ast.Tuple():
            return isinstance(node.ctx, ast.Store)
        case ast.IfExp(test=test):
            return test is node
    return not isinstance(parent, ast.Call | ast.keyword | ast.Return | ast.Dict | ast.NamedExpr | ast.List)


def _stored(statement: ast.AST) -> object:
    value = statement.value if isinstance(statement, ast.Assign) else None
    return value.value if isinstance(value, ast.Constant) else None


def _are_flags(value: ast.expr | None, method: Function) -> bool:
    """Whether an expression has only True and False as items."""
    match value:
        case ast.BinOp(left=ast.List() as items, op=ast.Mult()):
            return _are_flags(items, method)
        case ast.List(elts=elts):
            return all(isinstance(each, ast.Constant) and isinstance(each.value, bool) for each in elts)
    return False


def _shrinks(value: ast.expr | None, field: str, method: Function) -> bool:
    """Whether an expression has an item at most for each item of the attribute itself."""
    match value:
        case ast.Call(func=ast.Name(id="list" | "set" | "sorted" | "tuple"), args=[inner]):
            return _shrinks(inner, field, method)
        case ast.ListComp(generators=[part]) | ast.SetComp(generators=[part]) | ast.GeneratorExp(generators=[part]):
            return method.field(part.iter) == field
        case ast.Subscript(slice=ast.Slice()):
            return method.field(value.value) == field
    return method.field(value) == field
