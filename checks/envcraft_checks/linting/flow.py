"""Where values go: from a source, through names, attributes, arguments and results, to what play does with them."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator

from .program import Function, Program, arguments, name_of, root

#: Calls that pace, show or log, and change nothing in the game.
NEUTRAL = frozenset({
    "add_scalar", "critical", "debug", "delay", "error", "exception", "flip", "info", "log", "print", "pump",
    "set_caption", "sleep", "tick", "tick_busy_loop", "wait", "warn", "warning", "write",
})  # fmt: skip
#: The most rounds in which values spread: each round goes through all statements in order.
_ROUNDS = 10
KEEPS = frozenset({"add", "append", "appendleft", "extend", "insert", "put", "update"})


class Flow:
    """Where the value of a node may be, anywhere in some functions. The order of statements does not count.

    Args:
        program: the file.
        functions: what runs.
        source: the node.

    Attributes:
        results: the functions that return such a value.
    """

    def __init__(self, program: Program, functions: list[Function], source: ast.AST) -> None:
        self.program = program
        self.functions = functions
        self._source = source
        self._fields: set[tuple[str, str]] = set()
        self._names: dict[Function, set[str]] = defaultdict(set)
        self.results: set[Function] = set()
        for _ in range(_ROUNDS):
            size = self._size()
            for function in functions:
                self._spread(function)
            if size == self._size():
                break

    def uses(self) -> Iterator[ast.AST]:
        """Yield what decides, draws or returns by such a value."""
        for function in self.functions:
            for node in function.nodes:
                match node:
                    case ast.If(test=test, body=body, orelse=orelse) if self.reaches(test, function):
                        if not all(self._neutral(one, function) for one in [*body, *orelse]):
                            yield test
                    case ast.While(test=test) | ast.IfExp(test=test) if self.reaches(test, function):
                        yield test
                    case ast.Expr(value=ast.Call() as call) if self._acts(call, function):
                        yield call
                    case ast.Return(value=ast.Tuple(elts=elts)) if function.name in ("step", "reset"):
                        yield from (one for one in elts[:-1] if self.reaches(one, function))

    def reaches(self, node: ast.AST | None, function: Function) -> bool:
        """Whether an expression contains such a value."""
        return node is not None and any(self._is(one, function) for one in ast.walk(node))

    def _is(self, node: ast.AST, function: Function) -> bool:
        if node is self._source:
            return True
        if isinstance(node, ast.Name):
            return node.id in self._names[function]
        if isinstance(node, ast.Call) and (called := self.program.called(node, function)):
            return called in self.results
        return bool(field := function.field(node)) and (self.program.bound_to(function), field) in self._fields

    def _size(self) -> int:
        return len(self._fields) + len(self.results) + sum(map(len, self._names.values()))

    def _spread(self, function: Function) -> None:
        for target, value, _ in function.bindings:
            if self.reaches(value, function):
                self._take(target, function)
        for node in function.nodes:
            match node:
                case ast.AugAssign(target=target, value=value) if self.reaches(value, function):
                    self._take(root(target), function)
                case ast.Assign(targets=[ast.Subscript() as target], value=value) if self.reaches(value, function):
                    self._take(root(target), function)
                case ast.Return(value=value) if function.name not in ("step", "reset") and self.reaches(
                    value, function
                ):
                    self.results.add(function)
                case ast.Call():
                    self._pass_on(node, function)

    def _pass_on(self, call: ast.Call, function: Function) -> None:
        if not any(self.reaches(one, function) for one in [*call.args, *call.keywords]):
            return
        if (called := self.program.called(call, function)) is not None:
            taken = (parameter for parameter, value in arguments(call, called) if self.reaches(value, function))
            self._names[called].update(taken)
        elif isinstance(call.func, ast.Attribute) and call.func.attr in KEEPS:
            self._take(root(call.func.value), function)

    def _take(self, target: ast.AST, function: Function) -> None:
        if field := function.field(target):
            self._fields.add((self.program.bound_to(function), field))
        elif isinstance(target, ast.Name):
            self._names[function].add(target.id)

    def _acts(self, call: ast.Call, function: Function) -> bool:
        name = name_of(call)
        if name in NEUTRAL or name in KEEPS or self.program.called(call, function) is not None:
            return False
        return any(self.reaches(one, function) for one in [*call.args, *call.keywords])

    def _neutral(self, statement: ast.stmt, function: Function) -> bool:
        """Whether a statement only paces, shows, logs, or keeps such a value."""
        match statement:
            case ast.Pass():
                return True
            case ast.Expr(value=ast.Call() as call):
                return name_of(call) in NEUTRAL
            case ast.Expr():
                return True
            case ast.Assign(targets=[target]) | ast.AugAssign(target=target):
                return self._is(target, function) or "fps" in name_of(target).lower()
        return False
