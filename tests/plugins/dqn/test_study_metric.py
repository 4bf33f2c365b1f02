"""The figures of a study, beside what brute force gives."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from envcraft_dqn.study.metric import Change, Score, by_length, by_return, paired, pooled

from envcraft.judging.statistics import Mean


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
    # Squared errors of 28 and 4 (20/12)², with two degrees of freedom each, have 3.37 together, by Welch.
    assert found.high - found.value == pytest.approx(2.994 * found.standard_error, rel=2e-3)


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
    player, chance, best = (score(one[0].tolist()) for one in sets)
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
    found = pooled([change("a", 5), change("b", 1), change("c", -4), change("d", 0)])
    assert found.count == 4
    assert found.value.mean == pytest.approx(0.5)
    assert found.steps.mean == pytest.approx(0.05)
    assert found.improved.mean == 0.5
    assert found.richer.mean == 0.25
    assert (found.above, found.below) == (1, 1)
    assert found.improved.low < 0.5 < found.improved.high


@pytest.mark.parametrize("count", [2, 3, 6, 12])
def test_interval_over_few_environments_holds_the_true_mean(count: int) -> None:
    rng = np.random.default_rng(count)
    found = [pooled([change("a", value) for value in rng.normal(7, 20, count).tolist()]).value for _ in range(2000)]
    assert 0.935 < sum(one.low < 7 < one.high for one in found) / 2000 < 0.965


def test_a_single_environment_says_nothing_of_others() -> None:
    found = pooled([change("a", 50)])
    assert (found.value.mean, found.value.low, found.value.high) == (50, -inf, inf)
    lead = paired([change("a", 50)], [change("a", 10)])
    assert lead is not None
    assert (lead.mean, lead.low, lead.high) == (40, -inf, inf)


@pytest.mark.parametrize("episodes", [2, 3, 5])
def test_intervals_of_few_episodes_hold_the_true_figure(episodes: int) -> None:
    rng = np.random.default_rng(episodes)

    def drawn(mean: float) -> Score:
        return score(rng.normal(mean, mean / 3, episodes).tolist())

    found = [by_length(drawn(60), drawn(45), 0) for _ in range(1000)]
    true = 100 * (60 / 45 - 1)
    assert sum(one.low < true < one.high for one in found) / 1000 > 0.93


def test_pairs_are_of_the_same_environment() -> None:
    ours = [change("a", 5), change("b", 50), change("d", 900)]
    theirs = [change("b", 10), change("a", 5), change("c", 800)]
    found = paired(ours, theirs)
    assert found is not None
    assert found.mean == pytest.approx(20)
    assert paired(ours, [change("z", 1)]) is None
