"""Whether the code of an environment can pay anything, read from its syntax tree."""

from __future__ import annotations

import ast

from envcraft.model.target import parse

_NUMBERS = {"float", "int", "round", "abs", "float32", "float64"}
_RESULTS = 5


def pays_nothing(text: str) -> bool:
    """Whether every ``step`` in a file returns a tuple whose reward is zero for certain.

    A name or an attribute is zero if it is bound to zeros only, anywhere in the file. So a name that some other
    function binds to a number is not certain, nor is an argument or the result of a call.

    Args:
        text: the source. One that cannot be parsed may pay.
    """
    try:
        tree = parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    zeros = _Zeros(tree)
    steps = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "step"]
    returned = [node.value for step in steps for node in ast.walk(step) if isinstance(node, ast.Return)]
    return bool(returned) and all(
        isinstance(value, ast.Tuple) and len(value.elts) == _RESULTS and zeros.is_zero(value.elts[1])
        for value in returned
    )


class _Zeros:
    """The names of a file that are bound to zeros only."""

    def __init__(self, tree: ast.Module) -> None:
        #: What each name or attribute is bound to; None stands for anything.
        self._bound: dict[str, list[ast.expr | None]] = {}
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
                self._bound.setdefault(name, []).append(None)
            case ast.Global(names=names) | ast.Nonlocal(names=names):
                for name in names:
                    self._bound.setdefault(name, []).append(None)

    def _bind(self, target: ast.expr, value: ast.expr | None) -> None:
        match target:
            case ast.Name(id=name) | ast.Attribute(attr=name):
                self._bound.setdefault(name, []).append(value)
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                values = value.elts if isinstance(value, ast.Tuple) and len(value.elts) == len(parts) else None
                for at, part in enumerate(parts):
                    self._bind(part, values[at] if values is not None else None)
            case ast.Starred(value=part):
                self._bind(part, None)

    def is_zero(self, value: ast.expr | None, within: frozenset[str] = frozenset()) -> bool:
        """Whether an expression is zero for certain; `within` are the names whose bindings lead to it."""
        match value:
            case ast.Constant(value=number):
                return isinstance(number, int | float) and number == 0
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=part):
                return self.is_zero(part, within)
            case ast.BinOp(left=one, op=ast.Mult(), right=other):
                return self.is_zero(one, within) or self.is_zero(other, within)
            case ast.BinOp(left=one, op=ast.Add() | ast.Sub(), right=other):
                return self.is_zero(one, within) and self.is_zero(other, within)
            case ast.BinOp(left=one, op=ast.Div() | ast.FloorDiv()):
                return self.is_zero(one, within)
            case ast.IfExp(body=one, orelse=other):
                return self.is_zero(one, within) and self.is_zero(other, within)
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name), args=[part, *_]) if name in _NUMBERS:
                return self.is_zero(part, within)
            case ast.Name(id=name) | ast.Attribute(attr=name):
                bound = self._bound.get(name, [])
                # A name whose value depends on itself is zero if all its other bindings are.
                return name in within or (bool(bound) and all(self.is_zero(each, within | {name}) for each in bound))
        return False
