"""Intervals against published values, and tests that stop early."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from envcraft.stats import Proportion, settle


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
    rate = Proportion(hits, n, z=1.959964)
    assert rate.low == pytest.approx(low, abs=5e-5)
    assert rate.high == pytest.approx(high, abs=5e-5)


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_interval_holds_the_estimate_and_mirrors(pair: tuple[int, int]) -> None:
    hits, n = pair
    rate, mirrored = Proportion(hits, n), Proportion(n - hits, n)
    assert 0 <= rate.low <= rate.estimate + 1e-12
    assert rate.estimate - 1e-12 <= rate.high <= 1
    assert rate.low == pytest.approx(1 - mirrored.high)


def test_no_trial_says_nothing() -> None:
    assert (Proportion(0, 0).low, Proportion(0, 0).high) == (0.0, 1.0)


def test_settles_at_the_first_look_that_tells() -> None:
    asked: list[int] = []

    def trial(number: int) -> bool:
        asked.append(number)
        return False

    verdict, rate = settle(trial, 0.8, (6, 12, 24))
    assert verdict is False
    assert asked == list(range(6))
    assert (rate.hits, rate.n) == (0, 6)


def test_above_takes_as_many_looks_as_it_needs() -> None:
    verdict, rate = settle(lambda number: True, 0.8, (6, 12, 24))
    assert verdict is True
    assert rate.n == 24


def test_undecided_is_none_after_the_last_look() -> None:
    verdict, rate = settle(lambda number: number % 5 != 0, 0.8, (6, 12))
    assert verdict is None
    assert rate.n == 12
