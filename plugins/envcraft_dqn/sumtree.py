"""A sum tree over priorities: draws in proportion to them, and changes them, a batch at a call.

Each node has sixteen children that lie side by side, so a million leaves take five levels, of which all but the lowest
two stay in the processor's cache; a binary tree takes twenty. Inner nodes are always the sum of their children in order
and never a sum that was added to, so a tree that is built anew from its leaves is the same bit by bit.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_FAN = 16

_Floats = NDArray[np.float64]
_Integers = NDArray[np.int64]


class SumTree:
    """`size` leaves, whose priorities are 0 at first."""

    def __init__(self, size: int) -> None:
        counts = [_blocks(size) * _FAN]
        while counts[-1] > _FAN:
            counts.append(_blocks(counts[-1] // _FAN) * _FAN)
        self.size = size
        #: Where each level begins, leaves first, and at the end how many nodes there are.
        self._starts = np.cumsum([0, *counts])
        self._nodes = np.zeros(self._starts[-1])

    @property
    def total(self) -> float:
        """The sum of all priorities."""
        return float(_total(self._nodes, self._starts))

    @property
    def leaves(self) -> _Floats:
        """A view of all priorities, of shape [size], to be read."""
        return self._nodes[: self.size]

    @property
    def nbytes(self) -> int:
        return int(self._nodes.nbytes)

    def fill(self, priorities: _Floats) -> None:
        """Take the priorities of all leaves."""
        self._nodes[: self.size] = priorities
        for level in range(len(self._starts) - 2):
            first, above, end = self._starts[level : level + 3]
            parents = np.arange((above - first) // _FAN, dtype=np.int64)
            _sum_children(self._nodes, first, above, parents, len(parents))
            assert above + len(parents) <= end

    def set(self, indices: _Integers, priorities: _Floats) -> None:
        """Give the leaves at `indices` these priorities, none below 0; of an index that comes twice the last counts."""
        _set(self._nodes, self._starts, indices, priorities)

    def before(self, index: int) -> float:
        """The sum of the priorities of all leaves before the one at `index`."""
        return float(_before(self._nodes, self._starts, index))

    def draw(self, uniforms: _Floats, low: float = 0.0, high: float | None = None) -> tuple[_Integers, _Floats]:
        """Draw one leaf from each of as many equal parts of the sums from `low` to `high` as there are `uniforms`,
        which lie in [0, 1): stratified sampling (Schaul et al. 2016, arXiv:1511.05952, appendix B.2.1).

        Gives indices in ascending order, and their priorities. A leaf of priority 0 is never drawn, unless all are.
        """
        indices = np.empty(len(uniforms), np.int64)
        priorities = np.empty(len(uniforms))
        _draw(self._nodes, self._starts, uniforms, low, self.total if high is None else high, indices, priorities)
        return indices, priorities


def _blocks(count: int) -> int:
    return max(-(-count // _FAN), 1)


@numba.njit(cache=True, nogil=True)
def _total(nodes: _Floats, starts: _Integers) -> float:
    total = 0.0
    for node in range(starts[-2], starts[-1]):
        total += nodes[node]
    return total


@numba.njit(cache=True, nogil=True)
def _sum_children(nodes: _Floats, first: int, above: int, parents: _Integers, count: int) -> None:
    """Sum the children of `count` parents, which are numbered within their level; it begins at `above`."""
    for at in range(count):
        child = first + parents[at] * _FAN
        total = 0.0
        for node in range(child, child + _FAN):
            total += nodes[node]
        nodes[above + parents[at]] = total


@numba.njit(cache=True, nogil=True)
def _set(nodes: _Floats, starts: _Integers, indices: _Integers, priorities: _Floats) -> None:
    count = 0
    parents = np.empty(len(indices), np.int64)
    for at in range(len(indices)):
        nodes[indices[at]] = priorities[at]
        parent = indices[at] // _FAN
        # Neighbours in the batch are often neighbours in the tree, and then share their parents.
        if count == 0 or parents[count - 1] != parent:
            parents[count] = parent
            count += 1
    for level in range(len(starts) - 2):
        _sum_children(nodes, starts[level], starts[level + 1], parents, count)
        last, count = count, 0
        for at in range(last):
            parent = parents[at] // _FAN
            if count == 0 or parents[count - 1] != parent:
                parents[count] = parent
                count += 1


@numba.njit(cache=True, nogil=True)
def _before(nodes: _Floats, starts: _Integers, index: int) -> float:
    total = 0.0
    for level in range(len(starts) - 1):
        block = index // _FAN
        for child in range(block * _FAN, index):
            total += nodes[starts[level] + child]
        index = block
    return total


@numba.njit(cache=True, nogil=True)
def _draw(
    nodes: _Floats,
    starts: _Integers,
    uniforms: _Floats,
    low: float,
    high: float,
    indices: _Integers,
    priorities: _Floats,
) -> None:
    count = len(uniforms)
    part = (high - low) / count
    left = np.empty(count)
    for at in range(count):
        left[at] = low + (at + uniforms[at]) * part
        indices[at] = 0
    # Level by level: the searches of one level do not wait for each other's memory.
    for level in range(len(starts) - 2, -1, -1):
        first = starts[level]
        for at in range(count):
            node = first + indices[at] * _FAN
            wanted = left[at]
            chosen, rest, done = node, 0.0, False
            for child in range(node, node + _FAN):
                priority = nodes[child]
                if priority > 0.0 and not done:
                    # Rounding can leave a rest behind the last child: that one is chosen then.
                    chosen, rest = child, wanted
                    done = wanted < priority
                    wanted -= priority
            left[at] = rest
            indices[at] = chosen - first
            if level == 0:
                priorities[at] = nodes[chosen]
