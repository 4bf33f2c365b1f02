"""The comparisons that decide how an episode ends."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, name_of
from .ranges import decides, names_end

_BEYOND = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)


def exact_tests(program: Program) -> Iterator[tuple[ast.Compare, ast.Attribute, ast.expr, Function]]:
    """Yield the tests of the end that compare an attribute with ``==``, where none compares it with ``<`` or the like.

    Yields:
        The comparison, the attribute, the other side, and the function.
    """
    tests = [
        (node, function)
        for function in program.play
        for node in function.nodes
        if isinstance(node, ast.Compare) and len(node.ops) == 1 and _ends(program, function, node)
    ]
    # What passes the number in steps may still end the episode by another test.
    passed = {name_of(side) for node, _ in tests if isinstance(node.ops[0], _BEYOND) for side in _sides(node)}
    for node, function in tests:
        for side, other in (_sides(node), _sides(node)[::-1]):
            if isinstance(node.ops[0], ast.Eq) and isinstance(side, ast.Attribute) and side.attr not in passed:
                yield node, side, other, function


def _sides(test: ast.Compare) -> list[ast.expr]:
    return [test.left, test.comparators[0]]


def _ends(program: Program, function: Function, test: ast.expr) -> bool:
    """Whether a test decides how an episode ends: by a name, by the flags that step() returns, or as the result of a
    method with such a name as ``_is_won``.
    """
    if decides(program, test):
        return True
    node: ast.AST = test
    while not isinstance(node, ast.stmt):
        node = program.parents[node]
        if isinstance(node, ast.IfExp | ast.comprehension | ast.UnaryOp):
            return False
    match node:
        case ast.Return(value=value):
            flags = _flags(function, value)
            return any(test in set(ast.walk(flag)) for flag in flags) if flags else names_end(function.name)
        case ast.If(test=tested, body=[*_, ast.Return(value=value)]) if test in set(ast.walk(tested)):
            flags = _flags(function, value)
            return any(map(_is_true, flags)) if flags else _is_true(value) and names_end(function.name)
        case ast.Assign(targets=[ast.Name(id=name)]) if not isinstance(test, ast.Name):
            named = (one for one in function.nodes if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load))
            return any(one.id == name and _ends(program, function, one) for one in named)
    return False


def _flags(function: Function, value: ast.expr | None) -> list[ast.expr]:
    """The two flags if an expression is what step() returns."""
    return value.elts[2:4] if function.name == "step" and isinstance(value, ast.Tuple) else []


def _is_true(node: ast.expr | None) -> bool:
    return isinstance(node, ast.Constant) and node.value is True
