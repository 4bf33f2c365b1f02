"""The sum tree beside sums over a plain array."""

from __future__ import annotations

import numpy as np
import pytest
from envcraft_dqn.sumtree import SumTree
from hypothesis import given, settings
from hypothesis import strategies as st

PRIORITIES = st.one_of(st.just(0.0), st.floats(1e-9, 1e9))


@settings(max_examples=40, deadline=None)
@given(st.data(), st.integers(1, 5000))
def test_a_tree_agrees_with_an_array(data: st.DataObject, size: int) -> None:
    tree, plain = SumTree(size), np.zeros(size)
    for _ in range(data.draw(st.integers(1, 4))):
        count = data.draw(st.integers(1, 40))
        indices = np.array(data.draw(st.lists(st.integers(0, size - 1), min_size=count, max_size=count)), np.int64)
        values = np.array(data.draw(st.lists(PRIORITIES, min_size=count, max_size=count)))
        tree.set(indices, values)
        for index, value in zip(indices, values, strict=True):
            plain[index] = value
    assert (tree.leaves == plain).all()
    assert tree.total == pytest.approx(plain.sum())
    where = data.draw(st.integers(0, size))
    assert tree.before(where) == pytest.approx(plain[:where].sum(), abs=1e-9 * max(plain.sum(), 1.0))
    if plain.any():
        uniforms = np.array(data.draw(st.lists(st.floats(0, 1, exclude_max=True), min_size=1, max_size=40)))
        found, priorities = tree.draw(uniforms)
        assert (priorities == plain[found]).all()
        assert (priorities > 0).all()
        # A leaf is drawn where the sum before it and the sum with it have the wanted one between them.
        wanted = (np.arange(len(uniforms)) + uniforms) / len(uniforms) * plain.sum()
        ends = np.cumsum(plain)
        slack = 1e-9 * plain.sum()
        assert (wanted >= ends[found] - plain[found] - slack).all()
        assert (wanted <= ends[found] + slack).all()


def test_a_tree_that_is_built_anew_is_the_same_bit_by_bit() -> None:
    rng = np.random.default_rng(0)
    tree, again = SumTree(70_000), SumTree(70_000)
    for _ in range(50):
        tree.set(rng.integers(0, 70_000, 500), rng.random(500) ** 3)
    again.fill(tree.leaves)
    assert tree.total == again.total
    uniforms = rng.random(1000)
    for one, other in zip(tree.draw(uniforms), again.draw(uniforms), strict=True):
        assert (one == other).all()


def test_leaves_are_drawn_as_often_as_their_priorities_say() -> None:
    from scipy import stats

    rng = np.random.default_rng(1)
    tree = SumTree(300)
    priorities = np.where(rng.random(300) < 0.3, 0.0, rng.random(300) + 0.05)
    tree.set(np.arange(300), priorities)
    counts = np.zeros(300)
    draws = 200_000
    for _ in range(draws // 10):
        np.add.at(counts, tree.draw(rng.random(10))[0], 1)
    some = priorities > 0
    assert not counts[~some].any()
    # Stratified draws vary less than independent ones do, so that p is near 1; it falls where a share is off.
    assert stats.chisquare(counts[some], priorities[some] / priorities.sum() * draws).pvalue > 0.01


def test_a_part_of_the_tree_can_be_drawn_from() -> None:
    tree = SumTree(1000)
    tree.set(np.arange(1000), np.ones(1000))
    border = tree.before(400)
    rng = np.random.default_rng(2)
    assert tree.draw(rng.random(64), 0.0, border)[0].max() < 400
    assert tree.draw(rng.random(64), border)[0].min() >= 400
