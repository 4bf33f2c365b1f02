"""The dtype of pictures, as far as the text of the functions that draw them says."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of, root

_RESULTS, _DEPTH = 5, 3
_BYTE, _FLOAT, _INT = "uint8", "float64", "int"
#: Functions of NumPy that fill an array, with the position of their dtype, and whether it is float64 without one.
_FILLED = {"zeros": (1, True), "ones": (1, True), "empty": (1, True), "full": (2, False)}
#: What returns an array of the same dtype: a method of it, or a function that gets it first.
_SAME = frozenset({
    "ascontiguousarray", "clip", "copy", "flip", "fliplr", "flipud", "repeat", "reshape", "roll", "rot90", "squeeze",
    "swapaxes", "transpose",
})  # fmt: skip


def float_pictures(program: Program) -> Iterator[Suspect]:
    """Find where a picture of bytes becomes one of floats, or where NumPy refuses to write floats into one."""
    space = [value for value, _ in program.field_values(program.env).get("observation_space", [])]
    space += [program.class_values(program.env).get("observation_space", ("", None))[1]]
    if not any(name_of(part) == _BYTE for value in space if value for part in ast.walk(value)):
        return
    for function, values in observing(program):
        dtypes = _Dtypes(program, function, _DEPTH)
        yield from dtypes.refused
        for value in values:
            if isinstance(value, ast.Name):
                yield from dtypes.floats(value)


def observing(program: Program) -> Iterator[tuple[Function, list[ast.expr]]]:
    """The functions whose result is the observation, and what they return as such."""
    waiting = [program.method(program.env, name) for name in ("step", "reset", "render")]
    seen: set[Function] = set()
    while waiting:
        function = waiting.pop()
        if function is None or function in seen:
            continue
        seen.add(function)
        values = []
        for node in function.nodes:
            if isinstance(node, ast.Return) and node.value is not None:
                first = isinstance(node.value, ast.Tuple) and function.name in ("step", "reset")
                values.append(node.value.elts[0] if first and isinstance(node.value, ast.Tuple) else node.value)
        yield function, values
        bound = [each for value in values for each, _ in program.values(value, function)]
        for value in [*values, *bound]:
            if isinstance(value, ast.Call):
                waiting.append(program.called(value, function))


class _Dtypes:
    """The dtypes of the names of a function, statement by statement.

    Attributes:
        refused: additions and products in place that NumPy refuses.
    """

    def __init__(self, program: Program, function: Function, depth: int) -> None:
        self._program, self._function, self._depth = program, function, depth
        self._now: dict[str, str] = {}
        self._bound: dict[str, list[tuple[ast.AST, str]]] = {}
        self.refused: list[Suspect] = []
        for node in function.nodes:
            if isinstance(node, ast.AugAssign):
                self._change(node)
            for target, value, statement in function.bindings if isinstance(node, ast.Assign | ast.AnnAssign) else ():
                if statement is node and isinstance(target, ast.Name):
                    dtype = self.of(value)
                    self._bound.setdefault(target.id, []).append((node, dtype))
                    self._now[target.id] = dtype

    def floats(self, name: ast.Name) -> Iterator[Suspect]:
        """The last bindings of a returned name that make it float64, though others make it uint8."""
        bound = self._bound.get(name.id, [])
        last = [(node, dtype) for at, (node, dtype) in enumerate(bound) if not self._replaced(node, bound[at + 1 :])]
        if any(dtype == _BYTE for _, dtype in last):
            for node, dtype in last:
                if dtype == _FLOAT:
                    yield Suspect(line(node), f"makes {name.id} float64, and the observation space has uint8")

    def _replaced(self, node: ast.AST, later: list[tuple[ast.AST, str]]) -> bool:
        """Whether each way on from a statement leads to one of the later ones: one stands in a block around it."""
        around = {node, *self._program.around(node, self._function)}
        return any(not around.isdisjoint(self._program.block(each)) for each, _ in later)

    def of(self, node: ast.expr | None) -> str:
        """The dtype of an expression; "" if it is not known."""
        match node:
            case ast.Constant(value=float()):
                return _FLOAT
            case ast.Constant(value=bool()):
                return ""
            case ast.Constant(value=int()):
                return _INT
            case ast.Name(id=name):
                return self._now.get(name, "")
            case ast.Subscript(value=value):
                return self.of(value)
            case ast.UnaryOp(operand=operand):
                return self.of(operand)
            case ast.IfExp(body=body, orelse=orelse):
                first, second = self.of(body), self.of(orelse)
                return first if first == second else ""
            case ast.BinOp(left=left, op=op, right=right):
                return _joined(self.of(left), self.of(right), op)
            case ast.Call():
                return self._called(node)
        return ""

    def _called(self, node: ast.Call) -> str:
        name = name_of(node.func)
        if isinstance(node.func, ast.Attribute) and name == "astype" and node.args:
            return _named(node.args[0])
        if name in _FILLED:
            place, is_float = _FILLED[name]
            given = next((each.value for each in node.keywords if each.arg == "dtype"), None)
            given = given or (node.args[place] if len(node.args) > place else None)
            return _named(given) if given is not None else _FLOAT if is_float else ""
        if name == "array3d":
            return _BYTE
        if name in _SAME and isinstance(node.func, ast.Attribute):
            module = isinstance(node.func.value, ast.Name) and node.func.value.id in self._program.imports
            return self.of(node.args[0] if node.args else None) if module else self.of(node.func.value)
        called = self._program.called(node, self._function)
        if called is not None and self._depth:
            inner = _Dtypes(self._program, called, self._depth - 1)
            results = {inner.of(each.value) for each in called.nodes if isinstance(each, ast.Return)}
            return results.pop() if len(results) == 1 else ""
        return ""

    def _change(self, node: ast.AugAssign) -> None:
        target = root(node.target)
        array = isinstance(target, ast.Name) and self._now.get(target.id) == _BYTE
        if array and _joined(_BYTE, self.of(node.value), node.op) == _FLOAT:
            words = f"writes floats into {ast.unparse(node.target)[:40]}, an array of uint8, which NumPy refuses"
            self.refused.append(Suspect(line(node), words))


def _joined(left: str, right: str, op: ast.operator) -> str:
    """The dtype of a sum, a product or another result of two operands."""
    if isinstance(op, ast.Div) and left and right:
        return _FLOAT
    if _FLOAT in (left, right):
        # A float makes any number a float; what is not known may be an array of objects.
        return _FLOAT
    if _BYTE in (left, right):
        return _BYTE if {left, right} <= {_BYTE, _INT} else ""
    return _INT if left == right == _INT else ""


def _named(node: ast.expr) -> str:
    name = node.value if isinstance(node, ast.Constant) else name_of(node)
    return _BYTE if name == _BYTE else _FLOAT if name in ("float", "float32", "float64") else ""
