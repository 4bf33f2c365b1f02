"""Sums of fractions that a test of the end compares exactly."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from .ends import exact_tests
from .program import Function, Program, Suspect, bindings, line, name_of, outside
from .ranges import Ranges

#: The most sums that are computed, and the most terms of a sum that are written out.
_SUMS, _TERMS = 4_000, 4
#: How many of the largest terms further from the number than the first value a sum may be.
_PAST = 3
#: Names by which code gives an attribute a value that is not written as an assignment.
_INDIRECT = frozenset({"__dict__", "__setattr__", "replace", "setattr", "vars"})


@dataclass(frozen=True)
class _Miss:
    """A sum that equals a number by exact arithmetic, but not by that of floats.

    Attributes:
        terms: the first value, and what is added to it in turn.
        total: the sum in floats.
        never: whether no other sum in floats equals the number either.
    """

    terms: tuple[float, ...]
    total: float
    never: bool

    def __str__(self) -> str:
        first, *added = self.terms
        if len(added) > _TERMS and len(set(added)) == 1:
            words = f"{added[0]:g} added {len(added)} times to {first:g} is {self.total!r}"
        else:
            words = f"{' + '.join(f'{one:g}' for one in self.terms).replace('+ -', '- ')} is {self.total!r}"
        return f"{words}, and no other sum is equal" if self.never else words


def floats(program: Program) -> Iterator[Suspect]:
    """Find tests of the end that compare a sum of fractions with ``==``, and that a sum misses by rounding.

    An attribute is judged if all values that it gets are numbers in the code, or such numbers added to it. A test is
    certain to fail if no sum at all is equal.
    """
    ranges = Ranges(program)
    for node, side, other, function in exact_tests(program):
        target = ranges.constant(other, function)
        miss = None if target is None else _Sums(program, ranges, side.attr).missing(target)
        if miss is not None:
            yield Suspect(line(node), f"tests {ast.unparse(node)}, but {miss}", miss.never)


class _Sums:
    """The values of an attribute, of any object, as far as they are numbers in the code.

    Attributes:
        first: what it is set to before an episode.
        later: what play sets it to.
        added: what play adds to it.
        known: whether nothing else gives it a value.
    """

    def __init__(self, program: Program, ranges: Ranges, name: str) -> None:
        self._program, self._ranges, self._name = program, ranges, name
        self.first: set[float] = set()
        self.later: set[float] = set()
        self.added: set[float] = set()
        self.known = not any(name_of(node) in _INDIRECT for node in program.nodes)
        self._steps: list[tuple[ast.expr, Function]] = []
        stepping = program.reached("step")
        stores = sum(isinstance(node, ast.Attribute) and self._stored(node) for node in program.nodes)
        for function in program.all:
            for target, value, _ in function.bindings:
                if self._stored(target):
                    stores -= 1
                    self._set(value, function, self.later if function in stepping else self.first)
            for node in function.nodes:
                if isinstance(node, ast.AugAssign) and self._stored(node.target):
                    stores -= 1
                    self._add(node.op, node.value, function)
        # What an unused function stores is not known.
        self.known &= stores == 0
        self._declared()

    def _stored(self, node: ast.AST) -> bool:
        return isinstance(node, ast.Attribute) and node.attr == self._name and isinstance(node.ctx, ast.Store | ast.Del)

    def _set(self, value: ast.expr | None, function: Function | None, into: set[float]) -> None:
        if isinstance(value, ast.IfExp):
            self._set(value.body, function, into)
            self._set(value.orelse, function, into)
            return
        if function is not None and isinstance(value, ast.BinOp) and name_of(value.left) == self._name:
            self._add(value.op, value.right, function)
            return
        numbers = self._ranges.numbers(value, function)
        self.known &= bool(numbers)
        into.update(numbers)

    def _add(self, op: ast.operator, value: ast.expr, function: Function) -> None:
        numbers = self._ranges.numbers(value, function)
        self._steps.append((value, function))
        self.known &= bool(numbers) and isinstance(op, ast.Add | ast.Sub)
        self.added.update(-one if isinstance(op, ast.Sub) else one for one in numbers)

    def _declared(self) -> None:
        """Add what the bodies of classes give it, and the arguments that set it."""
        for name, node in self._program.classes.items():
            for target, value, _ in bindings(outside(node.body)):
                if name_of(target) == self._name:
                    self._set(value, None, self.first)
                    # Arguments without a name may set it.
                    calls = (call for call in self._program.nodes if isinstance(call, ast.Call))
                    self.known &= not any(name_of(call) == name and call.args for call in calls)
        for given in self._program.nodes:
            if isinstance(given, ast.keyword) and given.arg == self._name:
                self._set(given.value, None, self.first)

    def missing(self, target: float) -> _Miss | None:
        """A sum that equals a number by exact arithmetic only; None if there is none, or the values are not known."""
        if not self.known or not self.first or not self.added or target in self.later:
            return None
        if not self._is_fixed():
            return self._missing(target, self.added)
        missed = [miss for one in sorted(self.added) if (miss := self._missing(target, {one})) is not None]
        return next((miss for miss in missed if miss.never), missed[0] if missed else None)

    def _is_fixed(self) -> bool:
        """Whether all that is added in an episode is one number, which an attribute has from the reset on."""
        if len(self._steps) != 1:
            return False
        [(step, function)] = self._steps
        return bool(function.field(step)) and all(
            owner not in self._program.reached("step") for _, owner in self._program.values(step, function)
        )

    def _missing(self, target: float, added: set[float]) -> _Miss | None:
        upwards, downwards = (all(sign * one > 0 for one in added) for sign in (1, -1))
        whole = _exact(target)
        reach = max(abs(_exact(one) - whole) for one in self.first | self.later)
        reach += _PAST * max(abs(_exact(one)) for one in added)
        waiting: list[tuple[float, Fraction, tuple[float, ...]]]
        waiting = [(one, _exact(one), (one,)) for one in sorted(self.first | self.later)]
        seen, missed, equal = {(total, exact) for total, exact, _ in waiting}, None, False
        for total, exact, terms in waiting:
            # Sums that only grow do not come back.
            if (upwards and exact >= whole) or (downwards and exact <= whole) or abs(exact - whole) > reach:
                continue
            for one in sorted(added):
                later, exactly = total + one, exact + _exact(one)
                if (later, exactly) in seen:
                    continue
                if len(seen) >= _SUMS:
                    return None if missed is None else _Miss(*missed, never=False)
                seen.add((later, exactly))
                waiting.append((later, exactly, (*terms, one)))
                equal |= later == target
                if exactly == whole and later != target and missed is None:
                    missed = (*terms, one), later
        return None if missed is None else _Miss(*missed, never=(upwards or downwards) and not equal)


def _exact(number: float) -> Fraction:
    """The number that the digits of a float say."""
    return Fraction(repr(number))
