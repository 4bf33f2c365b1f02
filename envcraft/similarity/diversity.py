"""The effective number of different environments, by the Vendi score [1]_.

It is the exponential of the entropy of the eigenvalues of ``K / n``. ``K`` holds the similarity of each pair of n
items, with ones on its diagonal. The score is n if all items differ, 1 if all are the same, and k for k equally
frequent kinds.

.. [1] Friedman and Dieng, The Vendi Score: A Diversity Evaluation Metric for Machine Learning, 2022.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def vendi(kernel: NDArray[np.floating[Any]]) -> float:
    """The score of a positive semidefinite kernel of shape ``(n, n)``; 0 for an empty one."""
    return _effective(np.linalg.eigvalsh(kernel / len(kernel))) if len(kernel) else 0.0


def vendi_of_kinds(kinds: Iterable[Hashable]) -> float:
    """The score of items that are similar only within a kind: the eigenvalues are the shares of the kinds."""
    counts: dict[Hashable, int] = {}
    for kind in kinds:
        counts[kind] = counts.get(kind, 0) + 1
    total = sum(counts.values())
    return _effective([count / total for count in counts.values()]) if counts else 0.0


def _effective(shares: ArrayLike) -> float:
    """The exponential of the entropy."""
    found = np.asarray(shares, np.float64)
    found = found[found > 1e-12]
    return float(np.exp(-(found * np.log(found)).sum()))
