"""How much better than chance: for each environment with its error, and over all of them.

An environment's figure is the percentage by which its episodes are longer than those of random play, or, where length
is no measure, the return on a scale from 0 (random) to 100 (the privileged player). Both are functions of independent
means, whose errors are put together by the delta method, and degrees of freedom by Welch (1947,
doi:10.1093/biomet/34.1-2.28). Over environments it is a mean with the interval of Student's t: it is environments that
are counted, not episodes, since what is asked for is what another such environment would give. A percentile bootstrap
would miss the true mean of three environments once in four times, and that of twelve once in eleven.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import msgspec

from envcraft.stats import Mean, Proportion, student
from envcraft_dqn.evaluation import Evaluation


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
    """A mean over environments with its 95% interval, whose bounds are infinite (in JSON, null) for a single one."""

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
    errors = (agent.length.standard_error, ratio * random.length.standard_error)
    parts = [
        (100 * error / random.length.mean, score.episodes) for error, score in zip(errors, (agent, random), strict=True)
    ]
    return _change(agent, random, split, 100 * (ratio - 1), parts)


def by_return(agent: Score, random: Score, privileged: Score, split: int) -> Change | None:
    """The return from 0, random play's, to 100, the privileged player's; None where the interval of the latter's lead
    over the former does not lie above zero, so that there is no scale.

    With f = (a - r) / (p - r): df/da = 1 / (p - r), df/dr = (f - 1) / (p - r), df/dp = -f / (p - r).
    """
    room = privileged.total.mean - random.total.mean
    both = [(score.total.standard_error, score.episodes) for score in (privileged, random)]
    if room <= _spread(both)[1]:
        return None
    value = (agent.total.mean - random.total.mean) / room
    weights = ((agent, 1.0), (random, value - 1), (privileged, value))
    parts = [(100 * weight * score.total.standard_error / room, score.episodes) for score, weight in weights]
    return _change(agent, random, split, 100 * value, parts)


def _change(agent: Score, random: Score, split: int, value: float, parts: Sequence[tuple[float, int]]) -> Change:
    steps = agent.length.mean - random.length.mean
    total = agent.total.mean - random.total.mean
    error, half = _spread(parts)
    return Change(agent.name, split, value, error, value - half, value + half, steps, total)


def _spread(parts: Sequence[tuple[float, int]]) -> tuple[float, float]:
    """The standard error of a sum of independent means, and half of its 95% interval; `parts` are the standard error of
    each and the number of its episodes.
    """
    scattered = [(error**2, episodes - 1) for error, episodes in parts if error]
    if not scattered:
        return 0.0, 0.0
    variance = sum(part for part, _ in scattered)
    freedom = variance**2 / sum(part**2 / own for part, own in scattered)
    # Never fewer than the least of the parts has, but for rounding.
    return sqrt(variance), student(max(freedom, min(own for _, own in scattered))) * sqrt(variance)


def pooled(changes: Sequence[Change]) -> Pooled:
    """Over at least one environment."""
    values = [change.value for change in changes]
    return Pooled(
        len(changes),
        _mean(values),
        _mean([change.steps for change in changes]),
        _share(values),
        _share([change.total for change in changes]),
        sum(change.low > 0 for change in changes),
        sum(change.high < 0 for change in changes),
    )


def _share(values: Sequence[float]) -> Interval:
    """Of those above zero, with Wilson's interval."""
    found = Proportion(sum(value > 0 for value in values), len(values))
    return Interval(found.estimate, found.low, found.high)


def paired(changes: Sequence[Change], others: Sequence[Change]) -> Interval | None:
    """The mean by which the figures of `changes` lie above those of `others`, in the environments that both have."""
    known = {other.name: other.value for other in others}
    differences = [change.value - known[change.name] for change in changes if change.name in known]
    return _mean(differences) if differences else None


def _mean(values: Sequence[float]) -> Interval:
    found = Mean.of(values)
    return Interval(found.mean, found.low, found.high)
