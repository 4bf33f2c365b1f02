"""How many different environments there are, by the Vendi score: the exponential of the entropy of the eigenvalues of
``K / n``, where ``K`` has how alike each pair of n is, with ones on its diagonal [1]_. It is n where nothing is like
anything else, 1 where all are the same, and k where there are k equally frequent kinds.

.. [1] Friedman and Dieng, The Vendi Score: A Diversity Evaluation Metric for Machine Learning, 2022.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def vendi(kernel: NDArray[np.floating[Any]]) -> float:
    """The score of a positive semidefinite kernel, shape ``(n, n)``; 0 of nothing."""
    return _effective(np.linalg.eigvalsh(kernel / len(kernel))) if len(kernel) else 0.0


def vendi_of_kinds(kinds: Iterable[Hashable]) -> float:
    """The score where things are alike only if they are of one kind: the eigenvalues are then the kinds' shares."""
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
