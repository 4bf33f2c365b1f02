"""Tests of the end that compare a count with ``==``, although the count may skip the number."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from .ends import exact_tests
from .program import Function, Program, Suspect, line, name_of
from .ranges import Ranges
from .tuples import numbers_in_tuples

#: Names under which another object may know the environment.
_ENVIRONMENT = re.compile(r"env|game|world|state|owner|parent", re.I)
#: Methods that put something in a list or a set.
_GROWING = frozenset({"add", "append", "appendleft", "extend", "insert", "update"})
#: The most values of a count that are tried.
_VALUES = 2_000


def skipped_numbers(program: Program) -> Iterator[Suspect]:
    """Find tests of the end that compare a count with ``==``, where a sum or a difference may skip the number.

    A count is judged if its first values are numbers in the code, and play only adds such numbers. If it moves in both
    directions, it may come back, and the test is only suspicious.
    """
    ranges = Ranges(program)
    for test, side, other, function in exact_tests(program):
        field, target = function.field(side), ranges.constant(other, function)
        if not field or target is None or program.bound_to(function) != program.env:
            continue
        count = _Count(program, ranges, field)
        if (skip := count.skip(target)) is not None:
            before, after, number = skip
            words = f"tests {ast.unparse(test)}, but line {number} may take self.{field} from {before:g} to {after:g}"
            yield Suspect(line(test), words, count.one_way)


class _Count:
    """The numbers that an attribute of the environment is set to, and those that play adds to it."""

    def __init__(self, program: Program, ranges: Ranges, field: str) -> None:
        self._program, self._ranges, self._field = program, ranges, field
        self._set: set[float] = set()
        self._added: dict[float, int] = {}
        self._known = not any(map(self._may_change, program.nodes))
        for method in ranges.methods:
            for target, value, statement in method.bindings:
                if method.field(target) == field:
                    self._bind(value, statement, method, field)
            for node in method.nodes:
                if isinstance(node, ast.AugAssign) and method.field(node.target) == field:
                    self._add(node.op, node.value, node, method)
        owned = program.class_values(program.env).get(field)
        if owned is not None:
            self._bind(owned[1], program.tree, None, field)

    def _may_change(self, node: ast.AST) -> bool:
        """Whether a node may set the attribute in a way that the methods of the environment do not show."""
        match node:
            case ast.Attribute(value=owner, attr=attr, ctx=ast.Store() | ast.Del()) if attr == self._field:
                given = {name for one in self._program.functions.values() for name in one.parameters}
                return bool(_ENVIRONMENT.search(name_of(owner))) or name_of(owner) in given
        return name_of(node) in ("__dict__", "setattr", "vars")

    def _is_weighed(self) -> bool:
        """Whether play calculates with the attribute, or compares it by size, beside what it adds: it may then keep the
        number from being skipped, or end the episode. A count that is set back may come to the number again.
        """
        for method in self._program.reached("step"):
            sums = set()
            for target, value, _ in method.bindings:
                if method.field(target) == self._field:
                    if not isinstance(value, ast.BinOp) or method.field(value.left) != self._field:
                        return True
                    sums.add(value)
            for node in (node for node in method.nodes if node not in sums):
                parts: list[ast.expr] = []
                match node:
                    case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
                        parts = [left, right]
                    case ast.Compare(left=left, ops=[ast.Lt() | ast.LtE() | ast.Gt() | ast.GtE()], comparators=others):
                        parts = [left, *others]
                if any(method.field(part) == self._field for part in parts):
                    return True
        return self._program.method(self._program.env, self._field) is not None

    @property
    def one_way(self) -> bool:
        """Whether play only ever makes the count larger, or only smaller."""
        return len({number > 0 for number in self._added}) == 1

    def _bind(self, value: ast.expr | None, node: ast.AST, method: Function | None, field: str) -> None:
        if method is not None and isinstance(value, ast.BinOp) and method.field(value.left) == field:
            self._add(value.op, value.right, node, method)
            return
        numbers = self._ranges.numbers(value, method)
        # What has gone past the number may start again.
        self._known &= bool(numbers) and not (method is not None and self._is_tested(node, method, in_sum=False))
        self._set |= numbers

    def _add(self, op: ast.operator, value: ast.expr, node: ast.AST, method: Function) -> None:
        numbers = self._ranges.numbers(value, method) if isinstance(op, ast.Add | ast.Sub) else set()
        if method is not None and not numbers and isinstance(op, ast.Add | ast.Sub):
            numbers = numbers_in_tuples(self._ranges, value, method)
        # A test of the sum may keep it from going past the number.
        self._known &= bool(numbers) and not self._is_tested(node, method, in_sum=True)
        self._known &= not self._is_weighed() and not self._runs_out(node, method)
        for number in numbers - {0.0}:
            self._added.setdefault(-number if isinstance(op, ast.Sub) else number, line(node))

    def _is_tested(self, node: ast.AST, method: Function, in_sum: bool) -> bool:
        """Whether a test around a statement compares the attribute by size: in a sum, or in any way."""
        tests = [one.test for one in self._program.around(node, method) if isinstance(one, ast.If)]
        compared = [
            part
            for test in tests
            for one in ast.walk(test)
            if isinstance(one, ast.Compare) and not isinstance(one.ops[0], ast.Eq | ast.NotEq)
            for part in ast.walk(one)
        ]
        if not in_sum:
            return any(method.field(part) == self._field for part in compared)
        sums = (part for part in compared if isinstance(part, ast.BinOp))
        return any(method.field(part) == self._field for one in sums for part in ast.walk(one))

    def _runs_out(self, node: ast.AST, method: Function) -> bool:
        """Whether an addition takes an item from a list or a set that steps never refill, so that the sum is known."""
        program = self._program
        blocks = [program.block(one) for one in (node, *program.around(node, method)) if isinstance(one, ast.stmt)]
        beside = {part for block in blocks for one in block for part in ast.walk(one)}
        taken = {
            method.field(target)
            for target, write in method.writes
            if write in beside and name_of(write) in ("discard", "pop", "popleft", "popitem", "remove")
        }
        steps = program.reached("step")
        grown = {one.field(target) for one in steps for target, write in one.writes if name_of(write) in _GROWING}
        grown |= {one.field(target) for one in steps for target, _, _ in one.bindings}
        return bool(taken - grown - {""})

    def skip(self, target: float) -> tuple[float, float, int] | None:
        """A value before the number, the value behind it that play may go on to, and the line that does it.

        Returns:
            None if the count meets the number, or its values are not known.
        """
        whole = all(number == int(number) for number in (*self._set, *self._added))
        if not self._known or not self._set or not whole or target in self._set:
            return None
        waiting = sorted(self._set)
        seen = set(waiting)
        for before in waiting:
            for number, at in sorted(self._added.items(), key=lambda item: (abs(item[0]), item)):
                after = before + number
                if (before - target) * (after - target) < 0:
                    return before, after, at
                nearer = abs(after - target) < abs(before - target)
                if nearer and after not in seen and after != target and len(seen) < _VALUES:
                    seen.add(after)
                    waiting.append(after)
        return None
