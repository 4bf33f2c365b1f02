"""Whether the code of an environment can pay anything, read from its syntax tree."""

from __future__ import annotations

import ast

from envcraft.model.target import parse

_NUMBERS = {"float", "int", "round", "abs", "float32", "float64"}
_RESULTS = 5


def pays_nothing(text: str) -> bool:
    """Whether every ``step`` in a file returns a tuple whose reward is zero for certain.

    A name that ``step`` binds is zero if it binds it to zeros only. Another name or an attribute is zero if it is bound
    to zeros only, anywhere in the file. An argument, or the result of a call, is not certain.

    Args:
        text: the source. One that cannot be parsed may pay.
    """
    try:
        tree = parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    everywhere = _Bindings(tree)
    found = 0
    for step in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "step"):
        zeros = _Zeros(everywhere.bound, _Bindings(step).bound)
        for value in (node.value for node in ast.walk(step) if isinstance(node, ast.Return)):
            if not (isinstance(value, ast.Tuple) and len(value.elts) == _RESULTS and zeros.is_zero(value.elts[1])):
                return False
            found += 1
    return found > 0


class _Bindings:
    """What each name or attribute in a part of a file is bound to; None stands for anything."""

    def __init__(self, tree: ast.AST) -> None:
        self.bound: dict[str, list[ast.expr | None]] = {}
        for node in ast.walk(tree):
            self._read(node)

    def _read(self, node: ast.AST) -> None:
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    self._bind(target, value)
            case ast.AnnAssign(target=target, value=bound) | ast.NamedExpr(target=target, value=bound):
                if bound is not None:
                    self._bind(target, bound)
            case ast.AugAssign(target=target, op=ast.Mult() | ast.Div() | ast.FloorDiv()):
                pass
            case ast.AugAssign(target=target, op=ast.Add() | ast.Sub(), value=value):
                self._bind(target, value)
            case ast.AugAssign(target=target) | ast.For(target=target) | ast.comprehension(target=target):
                self._bind(target, None)
            case ast.withitem(optional_vars=target) if target is not None:
                self._bind(target, None)
            case ast.arg(arg=name) | ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
                self.bound.setdefault(name, []).append(None)
            case ast.Global(names=names) | ast.Nonlocal(names=names):
                for name in names:
                    self.bound.setdefault(name, []).append(None)

    def _bind(self, target: ast.expr, value: ast.expr | None) -> None:
        match target:
            case ast.Name(id=name) | ast.Attribute(attr=name):
                self.bound.setdefault(name, []).append(value)
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                values = value.elts if isinstance(value, ast.Tuple) and len(value.elts) == len(parts) else None
                for at, part in enumerate(parts):
                    self._bind(part, values[at] if values is not None else None)
            case ast.Starred(value=part):
                self._bind(part, None)


class _Zeros:
    """Tells which expressions are zero, by the bindings `everywhere` in the file and those of the function `inside`."""

    def __init__(self, everywhere: dict[str, list[ast.expr | None]], inside: dict[str, list[ast.expr | None]]) -> None:
        self._everywhere = everywhere
        self._inside = inside

    def is_zero(
        self, value: ast.expr | None, inside: bool = True, within: frozenset[tuple[str, bool]] = frozenset()
    ) -> bool:
        """Whether an expression is zero for certain.

        Args:
            value: the expression.
            inside: whether it is one of the function.
            within: the names whose bindings lead to it.
        """

        def zero(part: ast.expr) -> bool:
            return self.is_zero(part, inside, within)

        match value:
            case ast.Constant(value=number):
                return isinstance(number, int | float) and number == 0
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=part):
                return zero(part)
            case ast.BinOp(left=one, op=ast.Mult(), right=other):
                return zero(one) or zero(other)
            case ast.BinOp(left=one, op=ast.Add() | ast.Sub(), right=other) | ast.IfExp(body=one, orelse=other):
                return zero(one) and zero(other)
            case ast.BinOp(left=one, op=ast.Div() | ast.FloorDiv()):
                return zero(one)
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[part, *_]) if name in _NUMBERS:
                return zero(part)
            case ast.Name(id=name) if inside and name in self._inside:
                return self._is_bound_to_zeros(name, True, within)
            case ast.Name(id=name) | ast.Attribute(attr=name):
                return self._is_bound_to_zeros(name, False, within)
        return False

    def _is_bound_to_zeros(self, name: str, inside: bool, within: frozenset[tuple[str, bool]]) -> bool:
        if (name, inside) in within:
            # A name whose value depends on itself is zero if all its other bindings are.
            return True
        bound = (self._inside if inside else self._everywhere).get(name, [])
        return bool(bound) and all(self.is_zero(each, inside, within | {(name, inside)}) for each in bound)
