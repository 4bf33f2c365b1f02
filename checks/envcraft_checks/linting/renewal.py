"""Attributes whose objects reset() changes, also under another name, so that each episode may start anew."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator

from .flow import NEUTRAL
from .program import MUTATORS, Function, Program, arguments, name_of, root

#: What makes a container larger, and keeps what it held.
_GROWS = frozenset({"add", "append", "appendleft", "extend", "insert", "setdefault"})
#: Functions and methods whose result is what they were given, or a part of it, or gives its parts one by one.
_PASSES = frozenset({
    "asarray", "chain", "enumerate", "filter", "get", "items", "iter", "list", "map", "max", "min", "next", "nditer",
    "ravel", "reshape", "reversed", "sorted", "tuple", "values", "view", "zip",
})  # fmt: skip
#: Calls that give a number or a text.
_SCALARS = frozenset({
    "abs", "bool", "float", "hash", "int", "integers", "len", "randint", "random", "randrange", "round", "str", "sum",
    "uniform",
})  # fmt: skip
#: Calls that only read, show, log or mix what they are given.
_READERS = NEUTRAL | _SCALARS | {"choice", "choices", "permutation", "permuted", "sample", "shuffle"}
#: Built-in functions that run what they are given, or set an attribute.
_RUNNERS = frozenset({"delattr", "filter", "map", "next", "setattr"})
#: How far a value is looked up, and in how many rounds objects spread to names.
_DEPTH, _ROUNDS = 4, 10


def renewed(program: Program, resetting: list[Function]) -> set[str]:
    """The attributes whose objects these functions change in another way than by making them larger.

    For what step() runs, too, the code must show the change. What only reset() runs may also do it where the code does
    not show it, such as in a function of another file: play shows the rest.

    Args:
        program: the file.
        resetting: the functions that reset() may call.
    """
    names = _Names(program, resetting)
    stepping = set(program.reached("step"))
    found: set[str] = set()
    for function in resetting:
        for node in function.nodes:
            found |= names.changed(node, function)
            if function not in stepping:
                found |= names.suspected(node, function)
    return found


class _Names:
    """Which attributes' objects, or parts of them, a name may stand for, anywhere in some functions."""

    def __init__(self, program: Program, functions: list[Function]) -> None:
        self.program = program
        self._names: dict[tuple[Function, str], set[str]] = defaultdict(set)
        self._results: dict[Function, set[str]] = defaultdict(set)
        self._environments: set[tuple[Function, str]] = set()
        self._containers: dict[str, bool] = {}
        for _ in range(_ROUNDS):
            size = self._size()
            for function in functions:
                self._spread(function)
            if size == self._size():
                break

    def changed(self, node: ast.AST, function: Function) -> set[str]:
        """The attributes whose objects a node changes."""
        match node:
            case ast.Subscript(ctx=ast.Store() | ast.Del(), value=value):
                # A loop that counts up, or moves, what a container holds goes on from what it was.
                adds = isinstance(self.program.parents[node], ast.AugAssign) and not self._field(root(value), function)
                return set() if adds else self._of(value, function)
            case ast.Call(func=ast.Attribute(value=value, attr=attr)) if attr in MUTATORS - _GROWS:
                return self._of(value, function)
            case ast.AugAssign(target=target) if _empties(node):
                return self._of(target, function)
            case ast.Attribute(ctx=ast.Del()) if field := self._field(node, function):
                return {field}
            # The caller compares a value that is assigned to self with what it was.
            case ast.Attribute(ctx=ast.Store()) if not function.field(node) and (field := self._field(node, function)):
                return {field}
            # A method of the object may set it back.
            case ast.Attribute(value=value, attr=attr) if attr not in MUTATORS and (
                field := self._field(value, function)
            ):
                return {field}
        return set()

    def suspected(self, node: ast.AST, function: Function) -> set[str]:
        """The attributes whose objects a node may change in a way that the file does not show."""
        match node:
            case ast.Attribute(ctx=ast.Store(), value=value):
                return self._of(value, function)
            case ast.AugAssign(target=target, op=op) if not isinstance(op, ast.Add | ast.BitOr):
                return self._objects(target, function)
            case ast.Call() if name_of(node) in _READERS or self.program.called(node, function) is not None:
                return set()
            case ast.Call(args=args, keywords=keywords):
                found: set[str] = set()
                if isinstance(node.func, ast.Attribute) and node.func.attr not in MUTATORS:
                    found |= self._of(node.func.value, function)
                if self._runs_unknown(node, function):
                    given = [*args, *(keyword.value for keyword in keywords)]
                    found |= {field for one in given for field in self._objects(one, function)}
                return found
        return set()

    def _runs_unknown(self, call: ast.Call, function: Function) -> bool:
        """Whether a call may change what it is given."""
        library, _, name = self.program.path(call.func, function).partition(".")
        if library == "builtins":
            return name in _RUNNERS
        if library == "numpy":
            alone = isinstance(self.program.parents[call], ast.Expr)
            return alone or any(keyword.arg == "out" for keyword in call.keywords)
        return library not in ("copy", "json", "math")

    def _size(self) -> int:
        return len(self._environments) + sum(map(len, [*self._names.values(), *self._results.values()]))

    def _spread(self, function: Function) -> None:
        for target, value in _given(function):
            if objects := self._objects(value, function):
                for one in ast.walk(target):
                    if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store):
                        self._names[function, one.id] |= objects
        for node in function.nodes:
            if isinstance(node, ast.Return) and node.value is not None:
                self._results[function] |= self._objects(node.value, function)
            elif isinstance(node, ast.Call) and (called := self.program.called(node, function)) is not None:
                for parameter, value in arguments(node, called):
                    self._names[called, parameter] |= self._objects(value, function)
                    if self._is_environment(value, function):
                        self._environments.add((called, parameter))

    def _objects(self, node: ast.expr, function: Function) -> set[str]:
        return {field for field in self._of(node, function) if self._is_container(field)}

    def _of(self, node: ast.expr, function: Function) -> set[str]:
        """The attributes of which an expression may be the object, or a part of it."""
        if field := self._field(node, function):
            return {field}
        parts: Iterable[ast.expr] = ()
        match node:
            case ast.Name(id=name):
                return self._names.get((function, name), set())
            case ast.Attribute(value=value) | ast.Subscript(value=value) | ast.Starred(value=value):
                parts = [value]
            case ast.NamedExpr(value=value) | ast.DictComp(value=value):
                parts = [value]
            case ast.Tuple(elts=values) | ast.List(elts=values) | ast.Set(elts=values) | ast.Dict(values=values):
                parts = values
            case ast.BoolOp(values=values):
                parts = values
            case ast.IfExp(body=one, orelse=two) | ast.BinOp(op=ast.Add(), left=one, right=two):
                parts = [one, two]
            case ast.ListComp(elt=elt) | ast.SetComp(elt=elt) | ast.GeneratorExp(elt=elt):
                parts = [elt]
            case ast.Call() if (called := self.program.called(node, function)) is not None:
                return self._results.get(called, set())
            case ast.Call(func=func, args=args) if name_of(node) in _PASSES:
                parts = [*args, *([func.value] if isinstance(func, ast.Attribute) else [])]
        return {field for part in parts for field in self._of(part, function)}

    def _field(self, node: ast.AST, function: Function) -> str:
        """The attribute if the node is an attribute of the environment, else ""."""
        mine = isinstance(node, ast.Attribute) and self._is_environment(node.value, function)
        return node.attr if mine and isinstance(node, ast.Attribute) else ""

    def _is_environment(self, node: ast.expr, function: Function) -> bool:
        if not isinstance(node, ast.Name):
            return False
        own = node.id == function.me != "" and self.program.bound_to(function) == self.program.env
        return own or (function, node.id) in self._environments

    def _is_container(self, field: str) -> bool:
        """Whether an attribute may be more than a number or a text, which no other name can change."""
        if field not in self._containers:
            # What it is calculated from itself says nothing.
            self._containers[field] = False
            values = self.program.field_values(self.program.env).get(field, ())
            _, default = self.program.class_values(self.program.env).get(field, ("", ast.Constant(None)))
            self._containers[field] = self._may_hold(default, None, _DEPTH) or any(
                self._may_hold(value, function, _DEPTH) for value, function in values
            )
        return self._containers[field]

    def _may_hold(self, node: ast.expr | None, function: Function | None, depth: int) -> bool:
        if node is None or depth == 0:
            return True
        match node:
            case ast.Constant() | ast.JoinedStr():
                return False
            case ast.Call(args=[one, two]) if name_of(node) in ("max", "min"):
                return self._may_hold(one, function, depth - 1) or self._may_hold(two, function, depth - 1)
            case ast.Call():
                return name_of(node) not in _SCALARS
            case ast.UnaryOp(operand=operand):
                return self._may_hold(operand, function, depth - 1)
            case ast.BinOp(left=one, right=two) | ast.IfExp(body=one, orelse=two):
                return self._may_hold(one, function, depth - 1) or self._may_hold(two, function, depth - 1)
            case ast.BoolOp(values=values):
                return any(self._may_hold(value, function, depth - 1) for value in values)
            case ast.Compare(left=left, comparators=[right]):
                return self._may_hold(left, function, depth - 1) or self._may_hold(right, function, depth - 1)
            case ast.Attribute() if function is not None and (field := self._field(node, function)):
                return self._is_container(field)
            case ast.Name() | ast.Attribute():
                bound = self.program.values(node, function)
                return not bound or any(self._may_hold(value, owner, depth - 1) for value, owner in bound)
        return True


def _given(function: Function) -> Iterator[tuple[ast.expr, ast.expr]]:
    """Each target of an assignment, of a loop or of a comprehension, and what it is bound to or takes turns in."""
    for node in function.nodes:
        match node:
            case ast.Assign(targets=targets, value=value):
                yield from ((target, value) for target in targets)
            case ast.AnnAssign(target=target, value=ast.expr() as value) | ast.NamedExpr(target=target, value=value):
                yield target, value
            case ast.For(target=target, iter=value) | ast.comprehension(target=target, iter=value):
                yield target, value


def _empties(node: ast.AugAssign) -> bool:
    """Whether a statement such as ``x *= 0``, ``x &= False`` or ``x -= x`` leaves nothing of a value."""
    match node:
        case ast.AugAssign(op=ast.Mult() | ast.BitAnd(), value=ast.Constant(value=value)):
            return not value
        case ast.AugAssign(op=ast.Sub() | ast.BitXor() | ast.Mod()):
            return ast.unparse(node.target) == ast.unparse(node.value)
    return False
