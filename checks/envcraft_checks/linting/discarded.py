"""Statements that compute a value and do nothing with it."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line

#: Functions that leave their arguments as they are, and how many arguments they take before one for the result.
_PURE = {
    "builtins.abs": 1, "builtins.max": 9, "builtins.min": 9, "builtins.round": 2, "builtins.sorted": 1,
    "copy.copy": 1, "copy.deepcopy": 1, "numpy.abs": 1, "numpy.append": 3, "numpy.clip": 3, "numpy.concatenate": 2,
    "numpy.delete": 3, "numpy.flip": 2, "numpy.insert": 4, "numpy.maximum": 2, "numpy.minimum": 2, "numpy.roll": 3,
    "numpy.rot90": 3, "numpy.round": 2, "numpy.sort": 2, "numpy.transpose": 2, "numpy.where": 3,
}  # fmt: skip


def discarded_results(program: Program) -> Iterator[Suspect]:
    """Find calls without an effect whose result nothing takes, comparisons as statements, and methods without ()."""
    for function in program.reached("reset", "step", "__init__", "render"):
        for node in function.nodes:
            words = _words(program, node.value, function) if isinstance(node, ast.Expr) else ""
            # A statement may only ask whether it raises.
            if words and not any(isinstance(outer, ast.Try | ast.With) for outer in program.around(node, function)):
                yield Suspect(line(node), words)


def _words(program: Program, value: ast.expr, function: Function) -> str:
    text = ast.unparse(value)[:50]
    match value:
        case ast.Call(func=func, args=given, keywords=keywords):
            path = program.path(func, function)
            inner = [node for node in ast.walk(value) if isinstance(node, ast.Call | ast.NamedExpr)]
            plain = path in _PURE and len(inner) == 1 and len(given) <= _PURE[path]
            if (plain and not any(each.arg == "out" for each in keywords)) or _permutes(value, function):
                return f"computes {text} and discards the result"
        case ast.Compare(ops=[ast.Eq()]):
            return f"compares in a statement of its own, which does nothing: {text}"
        case ast.Attribute(attr=name) if function.field(value):
            owner = program.bound_to(function)
            method = program.method(owner, name)
            if method is not None and not method.node.decorator_list and name not in program.class_values(owner):
                return f"names the method {text} without calling it"
    return ""


def _permutes(call: ast.Call, function: Function) -> bool:
    """Whether a call permutes a copy of something by the environment's generator, as ``shuffle`` does in place."""
    match call:
        case ast.Call(func=ast.Attribute(value=generator, attr="permutation"), args=[permuted]):
            return function.field(generator) == "np_random" and isinstance(permuted, ast.Name | ast.Attribute)
    return False
