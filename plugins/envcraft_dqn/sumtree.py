"""A sum tree over priorities for batched sampling and updates (Schaul et al. 2016, arXiv:1511.05952).

Each node has sixteen adjacent children. A million leaves need five levels, of which all but the lowest two stay in the
cache of the processor; a binary tree needs twenty. Inner nodes are always recomputed as the sum of their children in
order, so that a tree rebuilt from its leaves is equal bit by bit.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

_FAN = 16

_Floats = NDArray[np.float64]
_Integers = NDArray[np.int64]


class SumTree:
    """A tree with `size` leaves, whose priorities start at 0."""

    def __init__(self, size: int) -> None:
        counts = [_blocks(size) * _FAN]
        while counts[-1] > _FAN:
            counts.append(_blocks(counts[-1] // _FAN) * _FAN)
        self.size = size
        #: The first node of each level, leaves first, followed by the number of nodes.
        self._starts = np.cumsum([0, *counts])
        self._nodes = np.zeros(self._starts[-1])

    @property
    def total(self) -> float:
        """The sum of all priorities."""
        return float(_total(self._nodes, self._starts))

    @property
    def leaves(self) -> _Floats:
        """A view of all priorities, [size]. Do not write to it."""
        return self._nodes[: self.size]

    @property
    def nbytes(self) -> int:
        """The size of the tree in bytes."""
        return int(self._nodes.nbytes)

    def fill(self, priorities: _Floats) -> None:
        """Set the priorities of all leaves, [size]."""
        self._nodes[: self.size] = priorities
        for level in range(len(self._starts) - 2):
            first, above, end = self._starts[level : level + 3]
            parents = np.arange((above - first) // _FAN, dtype=np.int64)
            _sum_children(self._nodes, first, above, parents, len(parents))
            assert above + len(parents) <= end

    def set(self, indices: _Integers, priorities: _Floats) -> None:
        """Set non-negative priorities [n] of leaves [n]. For repeated indices, the last priority counts."""
        _set(self._nodes, self._starts, indices, priorities)

    def before(self, index: int) -> float:
        """The sum of the priorities before a leaf."""
        return float(_before(self._nodes, self._starts, index))

    def draw(self, uniforms: _Floats, low: float = 0.0, high: float | None = None) -> tuple[_Integers, _Floats]:
        """Sample leaves by stratified sampling (Schaul et al. 2016, arXiv:1511.05952, appendix B.2.1).

        Args:
            uniforms: Uniform random numbers in [0, 1), one per leaf to sample, [n].
            low, high: The range of cumulative priorities to sample from; by default, all of it.

        Returns:
            The indices in ascending order [n], and their priorities [n]. A leaf with priority 0 is sampled only if all
            priorities are 0.
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
    """Sum the children of `count` parents, numbered within their level, which starts at `above`."""
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
        # Neighbours in the batch often share their parents.
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
    # Level by level, so that memory accesses of independent searches overlap.
    for level in range(len(starts) - 2, -1, -1):
        first = starts[level]
        for at in range(count):
            node = first + indices[at] * _FAN
            wanted = left[at]
            chosen, rest, done = node, 0.0, False
            for child in range(node, node + _FAN):
                priority = nodes[child]
                if priority > 0.0 and not done:
                    # Rounding can leave a remainder after the last child, which is then chosen.
                    chosen, rest = child, wanted
                    done = wanted < priority
                    wanted -= priority
            left[at] = rest
            indices[at] = chosen - first
            if level == 0:
                priorities[at] = nodes[chosen]
