"""The Vendi score: its known values, and that both ways to it agree."""

from __future__ import annotations

import numpy as np
import pytest

from envcraft.similarity.diversity import vendi, vendi_of_kinds
from envcraft.similarity.groups import Groups


def test_known_values() -> None:
    assert vendi(np.eye(7)) == pytest.approx(7)
    assert vendi(np.ones((7, 7))) == pytest.approx(1)
    assert vendi(np.kron(np.eye(3), np.ones((4, 4)))) == pytest.approx(3)
    assert vendi(np.zeros((0, 0))) == 0
    assert vendi_of_kinds([]) == 0


def test_half_alike_counts_between() -> None:
    half = np.full((2, 2), 0.5) + 0.5 * np.eye(2)
    # The eigenvalues of K / 2 are 3/4 and 1/4.
    assert vendi(half) == pytest.approx(np.exp(-(0.75 * np.log(0.75) + 0.25 * np.log(0.25))))


def test_kinds_are_the_kernel_of_equality() -> None:
    kinds = list("aaabbcddddd")
    kernel = np.array([[float(one == two) for one in kinds] for two in kinds])
    assert vendi_of_kinds(kinds) == pytest.approx(vendi(kernel))


def test_groups() -> None:
    groups = Groups(6)
    for one, two in ((4, 5), (3, 4), (1, 2)):
        groups.join(one, two)
    assert groups.all() == [[0], [1, 2], [3, 4, 5]]
    assert groups.same(3, 5)
    assert not groups.same(2, 3)
    assert groups.one([3, 4, 5])
    assert not groups.one([0, 3])
