"""How much better than chance: for each environment with its error, and over all of them.

An environment's figure is the percentage by which its episodes are longer than those of random play, or, where length
is no measure, the return on a scale from 0 (random) to 100 (the privileged player). Both are functions of independent
means, whose errors are put together by the delta method. Over environments it is a mean with a percentile bootstrap
interval (Efron and Tibshirani, "An Introduction to the Bootstrap", 1993): environments are drawn anew, not episodes,
since what is asked for is what another such environment would give.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.stats import Proportion
from envcraft_dqn.evaluation import Evaluation, Mean

#: Two-sided 95% of a normal distribution.
_Z = 1.959964
_RESAMPLES = 10_000
#: Of them drawn at a time: with a thousand environments, a few megabytes.
_CHUNK = 500


class Score(msgspec.Struct, frozen=True):
    """What a player came to in one environment: the means over its episodes."""

    name: str
    episodes: int
    length: Mean
    total: Mean

    @classmethod
    def of(cls, found: Evaluation) -> Score:
        return cls(found.name, found.episodes, found.length, found.total)


class Change(msgspec.Struct, frozen=True):
    """An environment's figure `value` with standard error and 95% interval; `steps` is by how much its episodes are
    longer than random play's, and `total` by how much they return more.
    """

    name: str
    split: int
    value: float
    standard_error: float
    low: float
    high: float
    steps: float
    total: float


class Interval(msgspec.Struct, frozen=True):
    """A mean over environments with its 95% interval."""

    mean: float
    low: float
    high: float


class Pooled(msgspec.Struct, frozen=True):
    """Over environments: the mean figure, the mean of `steps`, and the shares whose figure is above zero (`improved`)
    and whose return is higher than random play's (`richer`).

    `above` and `below` count those whose own interval lies above or below zero.
    """

    count: int
    value: Interval
    steps: Interval
    improved: Interval
    richer: Interval
    above: int
    below: int


def by_length(agent: Score, random: Score, split: int) -> Change:
    """The percentage by which episodes are longer than those of random play.

    The variance of a ratio a/r of independent means is, to the first order, (a/r)² (s_a²/a² + s_r²/r²).
    """
    ratio = agent.length.mean / random.length.mean
    error = 100 * sqrt(
        (agent.length.standard_error / random.length.mean) ** 2
        + (ratio * random.length.standard_error / random.length.mean) ** 2
    )
    return _change(agent, random, split, 100 * (ratio - 1), error)


def by_return(agent: Score, random: Score, privileged: Score, split: int) -> Change | None:
    """The return from 0, random play's, to 100, the privileged player's; None where the interval of the latter's lead
    over the former does not lie above zero, so that there is no scale.

    With f = (a - r) / (p - r): df/da = 1 / (p - r), df/dr = (f - 1) / (p - r), df/dp = -f / (p - r).
    """
    room = privileged.total.mean - random.total.mean
    doubt = _Z * sqrt(privileged.total.standard_error**2 + random.total.standard_error**2)
    if room <= doubt:
        return None
    value = (agent.total.mean - random.total.mean) / room
    parts = (
        agent.total.standard_error,
        (value - 1) * random.total.standard_error,
        value * privileged.total.standard_error,
    )
    error = 100 * sqrt(sum(part**2 for part in parts)) / room
    return _change(agent, random, split, 100 * value, error)


def _change(agent: Score, random: Score, split: int, value: float, error: float) -> Change:
    steps = agent.length.mean - random.length.mean
    total = agent.total.mean - random.total.mean
    return Change(agent.name, split, value, error, value - _Z * error, value + _Z * error, steps, total)


def pooled(changes: Sequence[Change], seed: int) -> Pooled:
    """Over at least one environment."""
    values = np.array([change.value for change in changes])
    steps = np.array([change.steps for change in changes])
    return Pooled(
        len(changes),
        bootstrap(values, seed),
        bootstrap(steps, seed),
        _share(values),
        _share(np.array([change.total for change in changes])),
        sum(change.low > 0 for change in changes),
        sum(change.high < 0 for change in changes),
    )


def _share(values: NDArray[Any]) -> Interval:
    """Of those above zero, with Wilson's interval."""
    found = Proportion(int((values > 0).sum()), len(values))
    return Interval(found.estimate, found.low, found.high)


def paired(changes: Sequence[Change], others: Sequence[Change], seed: int) -> Interval | None:
    """The mean by which the figures of `changes` lie above those of `others`, in the environments that both have."""
    known = {other.name: other.value for other in others}
    differences = [change.value - known[change.name] for change in changes if change.name in known]
    return bootstrap(np.array(differences), seed) if differences else None


def bootstrap(values: NDArray[Any], seed: int) -> Interval:
    """The mean of `values` [n] with its percentile interval, the same for the same seed."""
    rng = np.random.default_rng([seed, 13])
    means = [values[rng.integers(0, len(values), (_CHUNK, len(values)))].mean(1) for _ in range(_RESAMPLES // _CHUNK)]
    low, high = np.percentile(np.concatenate(means), [2.5, 97.5])
    return Interval(float(values.mean()), float(low), float(high))
