"""Costs and penalties whose sign makes them pay."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Program, Suspect, line, name_of
from .ranges import Ranges

#: The last word in the name of a number that a reward loses, and words before it that say something else.
_WORDS = frozenset({"cost", "costs", "fee", "penalties", "penalty", "toll"})
_OTHERS = frozenset({"base", "full", "max", "min", "most", "no", "total"})


def paying_costs(program: Program) -> Iterator[Suspect]:
    """Find a reward from which a negative cost is subtracted, or to which a positive one is added."""
    ranges = Ranges(program)
    if any(
        isinstance(one, ast.UnaryOp) and isinstance(one.op, ast.USub) and _is_reward(one.operand)
        for one in program.nodes
    ):
        return
    lost: set[str] = set()
    found: list[tuple[str, Suspect]] = []
    for function in program.play:
        for node in function.nodes:
            changes = [(name, added) for name, added in _changes(node) if _is_cost(name)]
            # A difference of two costs is no cost.
            for name, added in changes if len({added for _, added in changes}) == 1 else ():
                value = ranges.constant(name, function)
                if not value or (value > 0) != added:
                    lost.add(ast.unparse(name))
                    continue
                sign = "adds" if added else "subtracts"
                words = f"{sign} {ast.unparse(name)}, which is {value:g}, so that the cost pays {abs(value):g}"
                found.append((ast.unparse(name), Suspect(line(node), words)))
    # What is lost elsewhere may be paid back here.
    yield from (suspect for name, suspect in found if name not in lost)


def _is_cost(node: ast.expr) -> bool:
    *before, last = name_of(node).lower().strip("_").split("_")
    return last in _WORDS and _OTHERS.isdisjoint(before)


def _changes(node: ast.AST) -> Iterator[tuple[ast.expr, bool]]:
    """What a statement adds to a reward, or, with False, subtracts from it."""
    match node:
        case ast.AugAssign(target=target, op=ast.Add() | ast.Sub() as op, value=value) if _is_reward(target):
            yield from _terms(value, isinstance(op, ast.Add))
        case ast.Assign(targets=[target], value=value) if _is_reward(target):
            yield from _terms(value, added=True)


def _terms(node: ast.expr, added: bool) -> Iterator[tuple[ast.expr, bool]]:
    match node:
        case ast.Name() | ast.Attribute():
            yield node, added
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            yield from _terms(operand, not added)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            yield from _terms(left, added)
            yield from _terms(right, added == isinstance(op, ast.Add))
        case ast.IfExp(body=body, orelse=orelse):
            yield from _terms(body, added)
            yield from _terms(orelse, added)


def _is_reward(node: ast.expr) -> bool:
    return isinstance(node, ast.Name | ast.Attribute) and name_of(node).lower().strip("_") in (
        "reward",
        "rew",
        "rewards",
    )
