"""Comparisons of two lists that stop at the end of the shorter one."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from .program import Function, Program, Suspect, line, name_of


def short_comparisons(program: Program) -> Iterator[Suspect]:
    """Find ``all(a == b for a, b in zip(...))`` of a list that play empties and fills, and whose length nothing tests.

    Such a test is true of an empty list.
    """
    for function in program.play:
        for node in function.nodes:
            match node:
                case ast.Call(
                    func=ast.Name(id="all"),
                    args=[
                        ast.GeneratorExp(
                            elt=ast.Compare(ops=[ast.Eq()]),
                            generators=[
                                ast.comprehension(
                                    iter=ast.Call(func=ast.Name(id="zip"), args=pair, keywords=[]), ifs=[]
                                )
                            ],
                        )
                    ],
                ):
                    filled = [one for one in pair if _is_filled(program, function, one)]
                    if filled and len(filled) < len(pair) and not _is_measured(program, function.field(filled[0])):
                        shorter = ast.unparse(filled[0])
                        words = (
                            f"compares only as many items as {shorter} has, so an empty {shorter} is equal to any list"
                        )
                        yield Suspect(line(node), words)


def _is_filled(program: Program, function: Function, node: ast.expr) -> bool:
    """Whether play appends to an attribute one by one, and sets it to an empty list."""
    if not (field := function.field(node)):
        return False
    stepping = [one for one in program.reached("step") if program.bound_to(one) == program.env]
    appends = any(
        isinstance(write, ast.Call) and name_of(write) == "append" and one.field(target) == field
        for one in stepping
        for target, write in one.writes
    )
    values = [value for value, _ in program.field_values(program.env).get(field, ())]
    return appends and bool(values) and all(isinstance(value, ast.List) and not value.elts for value in values)


def _is_measured(program: Program, field: str) -> bool:
    """Whether play tests whether an attribute has items, or how many."""
    for function in program.play:
        for node in function.nodes:
            if (
                isinstance(node, ast.Call)
                and name_of(node) == "len"
                and any(function.field(one) == field for one in node.args)
            ):
                # The number of items that a list may have at most says nothing about an empty one.
                match program.parents[node]:
                    case ast.Compare(left=left, ops=[ast.Lt() | ast.LtE()]) if left is node:
                        continue
                return True
            tests = [node.test] if isinstance(node, ast.If | ast.While | ast.IfExp) else []
            tests += node.values if isinstance(node, ast.BoolOp) else []
            tests += [node.operand] if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not) else []
            if any(function.field(one) == field for one in tests):
                return True
    return False
