"""The figures of a study, beside what brute force gives."""

from __future__ import annotations

import numpy as np
import pytest
from envcraft_dqn.evaluation import Mean
from envcraft_dqn.study.metric import Change, Score, bootstrap, by_length, by_return, paired, pooled


def score(lengths: list[float], returns: list[float] | None = None, name: str = "a") -> Score:
    return Score(name, len(lengths), Mean.of(lengths), Mean.of(returns or lengths))


def change(name: str, value: float, error: float = 1.0) -> Change:
    return Change(name, 0, value, error, value - 2 * error, value + 2 * error, value / 10, -value)


def test_change_of_length_is_that_of_the_means() -> None:
    found = by_length(score([12, 18, 30]), score([10, 10, 16]), 3)
    assert found.value == pytest.approx(100 * (20 / 12 - 1))
    assert found.steps == pytest.approx(8)
    assert found.total == pytest.approx(8)
    assert (found.name, found.split) == ("a", 3)
    assert found.high - found.value == pytest.approx(1.959964 * found.standard_error)


def test_error_of_a_ratio_is_what_drawing_again_gives() -> None:
    rng = np.random.default_rng(0)
    agents, randoms = rng.gamma(2, 30, (4000, 200)), rng.gamma(3, 15, (4000, 200))
    ratios = 100 * (agents.mean(1) / randoms.mean(1) - 1)
    found = by_length(score(agents[0].tolist()), score(randoms[0].tolist()), 0)
    assert found.standard_error == pytest.approx(ratios.std(), rel=0.15)
    # The intervals of 300 of these pairs have the true value in them about as often as they say.
    true = 100 * (60 / 45 - 1)
    hits = 0
    for agent, random in zip(agents[:300], randoms[:300], strict=True):
        one = by_length(score(agent.tolist()), score(random.tolist()), 0)
        hits += one.low < true < one.high
    assert 0.91 < hits / 300 < 0.98


def test_error_of_a_normalised_return_is_what_drawing_again_gives() -> None:
    rng = np.random.default_rng(1)
    sets = [rng.normal(mean, 4, (4000, 50)) for mean in (3, 1, 9)]
    agent, random, privileged = (one.mean(1) for one in sets)
    values = 100 * (agent - random) / (privileged - random)
    player, chance, best = (score([1.0, 1.0], one[0].tolist()) for one in sets)
    found = by_return(player, chance, best, 0)
    assert found is not None
    assert found.standard_error == pytest.approx(values.std(), rel=0.2)
    assert found.value == pytest.approx(values[0])


def test_ends_of_the_scale_are_random_and_privileged() -> None:
    random, privileged = score([1, 1], [0.0, 2.0]), score([1, 1], [10.0, 12.0])
    for player, value in ((random, 0), (privileged, 100)):
        found = by_return(player, random, privileged, 0)
        assert found is not None
        assert found.value == pytest.approx(value)


def test_no_scale_where_the_privileged_player_is_not_better() -> None:
    assert by_return(score([1, 1], [3, 4]), score([1, 1], [0, 2]), score([1, 1], [1, 3]), 0) is None


def test_pooled_counts_what_improves() -> None:
    found = pooled([change("a", 5), change("b", 1), change("c", -4), change("d", 0)], 0)
    assert found.count == 4
    assert found.value.mean == pytest.approx(0.5)
    assert found.steps.mean == pytest.approx(0.05)
    assert found.improved.mean == 0.5
    assert found.richer.mean == 0.25
    assert (found.above, found.below) == (1, 1)
    assert found.improved.low < 0.5 < found.improved.high


def test_bootstrap_is_that_of_the_mean() -> None:
    values = np.random.default_rng(2).normal(7, 20, 80)
    found = bootstrap(values, 0)
    assert found.mean == pytest.approx(values.mean())
    half = 1.96 * values.std(ddof=1) / 80**0.5
    assert found.low == pytest.approx(values.mean() - half, abs=0.15 * half)
    assert found.high == pytest.approx(values.mean() + half, abs=0.15 * half)
    assert bootstrap(values, 0) == found != bootstrap(values, 1)


def test_pairs_are_of_the_same_environment() -> None:
    ours = [change("a", 5), change("b", 50), change("d", 900)]
    theirs = [change("b", 10), change("a", 5), change("c", 800)]
    found = paired(ours, theirs, 0)
    assert found is not None
    assert found.mean == pytest.approx(20)
    assert paired(ours, [change("z", 1)], 0) is None
