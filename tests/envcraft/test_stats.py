"""Intervals against published values, and tests that stop early."""

from __future__ import annotations

import random
from collections.abc import Callable
from math import inf, isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from envcraft.judging.budget import BUDGETS
from envcraft.judging.statistics import Exact, Mean, Proportion, lead, settle, student


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [
        # Newcombe (1998), "Two-sided confidence intervals for the single proportion", table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_is_the_published_one(hits: int, n: int, low: float, high: float) -> None:
    rate = Proportion(hits, n)
    assert rate.low == pytest.approx(low, abs=5e-5)
    assert rate.high == pytest.approx(high, abs=5e-5)


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [
        # The same table, method 5.
        (81, 263, 0.2527, 0.3676),
        (15, 148, 0.0578, 0.1617),
        (0, 20, 0.0, 0.1684),
        (1, 29, 0.0009, 0.1776),
    ],
)
def test_exact_interval_is_the_published_one(hits: int, n: int, low: float, high: float) -> None:
    rate = Exact(hits, n)
    assert (rate.low, rate.high) == pytest.approx((low, high), abs=5e-5)


@pytest.mark.parametrize("kind", [Proportion, Exact])
@given(pair=st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_holds_the_estimate_and_mirrors(kind: type[Proportion], pair: tuple[int, int]) -> None:
    hits, n = pair
    rate, mirrored = kind(hits, n), kind(n - hits, n)
    assert 0 <= rate.low <= rate.estimate
    assert rate.estimate <= rate.high <= 1
    assert rate.low == pytest.approx(1 - mirrored.high)


def test_interval_without_trials_is_everything() -> None:
    assert (Proportion(0, 0).low, Proportion(0, 0).high) == (0.0, 1.0)
    assert (Exact(0, 0).low, Exact(0, 0).high) == (0.0, 1.0)


def test_words_and_evidence_say_how_sure_they_are() -> None:
    _, rate = settle(lambda number: True, 0.8)
    assert str(rate) == "24 of 24 (100%, 99% interval 80.2% to 100%)"
    assert rate.evidence() == {
        "hits": 24,
        "n": 24,
        "estimate": 1.0,
        "low": pytest.approx(0.005 ** (1 / 24)),
        "high": 1.0,
        "confidence": 0.99,
    }


def test_settles_at_the_first_look_that_tells() -> None:
    requested: list[int] = []

    def trial(number: int) -> bool:
        requested.append(number)
        return False

    verdict, rate = settle(trial, 0.8, (6, 12, 24))
    assert verdict is False
    assert requested == list(range(6))
    assert (rate.hits, rate.n) == (0, 6)


def test_trials_stop_when_no_success_could_show_a_higher_rate() -> None:
    requested: list[int] = []

    def trial(number: int) -> bool:
        requested.append(number)
        return number != 2

    # Only 24 of 24 are significantly more than 80%.
    assert settle(trial, 0.8, (6, 12, 24), affords=lambda: True) == (None, Exact(2, 3, 0.01))
    assert requested == [0, 1, 2]


def test_stopping_changes_no_rate_above_the_threshold() -> None:
    rng, looks = random.Random(2), BUDGETS["thorough"].looks
    verdicts = []
    for _ in range(300):
        outcomes = [rng.random() < 0.93 for _ in range(96)]
        verdicts.append(settle(outcomes.__getitem__, 0.8, looks)[0] is True)
        assert (settle(outcomes.__getitem__, 0.8, looks, affords=lambda: True)[0] is True) == verdicts[-1]
    assert 20 < sum(verdicts) < 280


def test_trials_stop_when_the_budget_does_not_afford_one_more() -> None:
    left = iter([True, True, False])
    assert settle(lambda number: True, 0.8, affords=lambda: next(left)) == (None, Exact(3, 3, 0.01))


def test_above_takes_as_many_looks_as_it_needs() -> None:
    verdict, rate = settle(lambda number: True, 0.8, (6, 12, 24))
    assert verdict is True
    assert rate.n == 24


def test_undecided_is_none_after_the_last_look() -> None:
    verdict, rate = settle(lambda number: number % 5 != 0, 0.8, (6, 12))
    assert verdict is None
    assert rate.n == 12


def drawn(rate: float, rng: random.Random) -> Callable[[int], bool]:
    return lambda number: rng.random() < rate


@pytest.mark.parametrize("budget", ["quick", "thorough"])
@pytest.mark.parametrize("threshold", [0.05, 0.5, 0.8, 0.95, 0.99])
def test_settling_errs_at_most_once_in_twenty(threshold: float, budget: str) -> None:
    rng, looks = random.Random(0), BUDGETS[budget].looks
    told = [settle(drawn(threshold, rng), threshold, looks)[0] for _ in range(1000)]
    assert sum(verdict is not None for verdict in told) / 1000 < 0.05


def test_a_larger_budget_leaves_what_is_settled() -> None:
    # A game that is won 24 times, and then never again.
    assert settle(lambda number: number < 24, 0.8, BUDGETS["quick"].looks)[0] is True
    assert settle(lambda number: number < 24, 0.8, BUDGETS["thorough"].looks)[0] is True
    rng = random.Random(1)
    settled = 0
    for _ in range(300):
        outcomes = [rng.random() < 0.9 for _ in range(96)]
        few, rate = settle(outcomes.__getitem__, 0.8, BUDGETS["quick"].looks)
        if few is not None:
            settled += 1
            assert settle(outcomes.__getitem__, 0.8, BUDGETS["thorough"].looks) == (few, rate)
    assert settled > 10


def test_more_looks_than_any_budget_has_share_the_error() -> None:
    _, rate = settle(lambda number: True, 0.999, (1, 2, 3, 4, 5, 6, 7, 8, 9, 10))
    assert rate.error == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("freedom", "quantile"),
    # Fisher and Yates, "Statistical tables", table III; degrees between are rounded down up to three.
    [(1, 12.706), (2, 4.303), (2.9, 4.303), (4, 2.776), (5, 2.571), (10, 2.228), (30, 2.042), (120, 1.980)],
)
def test_quantile_is_the_published_one(freedom: float, quantile: float) -> None:
    assert student(freedom) == pytest.approx(quantile, abs=1e-3)
    assert student(3) == pytest.approx(3.182, rel=2e-3)
    assert student(0) == inf


@pytest.mark.parametrize("n", [2, 3, 5, 20])
def test_interval_of_a_mean_holds_the_true_one(n: int) -> None:
    rng = random.Random(n)
    found = [Mean.of([rng.gauss(3, 2) for _ in range(n)]) for _ in range(3000)]
    assert 0.94 < sum(one.low < 3 < one.high for one in found) / 3000 < 0.965


def test_one_value_says_nothing_of_the_others() -> None:
    assert Mean.of([5.0]) == Mean(5.0, inf, -inf, inf)


def test_what_is_not_finite_or_very_large_is_no_exception() -> None:
    assert isnan(Mean.of([inf, -inf]).mean)
    assert isnan(lead([nan, 1.0], [0.0, 0.0]).low)
    assert Mean.of([1e300, -1e300]).high == inf


def test_lead_is_paired() -> None:
    others = [float(number % 7) for number in range(30)]
    ours = [value + 0.1 * (1 + number % 2) for number, value in enumerate(others)]
    found = lead(ours, others)
    # Of 15 times 0.1 and 15 times 0.2 the standard error is 0.05 / sqrt(29), and t is 2.0452.
    half = 2.0452 * 0.05 / 29**0.5
    assert (found.mean, found.low, found.high) == pytest.approx((0.15, 0.15 - half, 0.15 + half), rel=1e-4)
    assert lead([1.0] * 30, [1.0] * 30) == Mean(0.0, 0.0, 0.0, 0.0)
