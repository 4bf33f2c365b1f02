"""Disjoint sets of numbers (union-find)."""

from __future__ import annotations


class Groups:
    """The numbers below `size`, each in a group of its own at first."""

    def __init__(self, size: int) -> None:
        self._above = list(range(size))

    def join(self, one: int, two: int) -> None:
        """Merge the groups of two numbers."""
        one, two = self._top(one), self._top(two)
        self._above[max(one, two)] = min(one, two)

    def same(self, one: int, two: int) -> bool:
        return self._top(one) == self._top(two)

    def one(self, numbers: list[int]) -> bool:
        """Whether all numbers are in one group."""
        return len({self._top(number) for number in numbers}) < 2

    def all(self) -> list[list[int]]:
        """All groups in the order of their lowest numbers, each sorted."""
        found: dict[int, list[int]] = {}
        for number in range(len(self._above)):
            found.setdefault(self._top(number), []).append(number)
        return list(found.values())

    def _top(self, number: int) -> int:
        above = self._above
        while above[number] != number:
            above[number] = number = above[above[number]]
        return number
