"""Proportions and means with confidence intervals, and a sequential test of a proportion."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import exp, fsum, inf, lgamma, log, log1p, pi, sqrt, tan

import msgspec

#: Numbers of episodes after which the sequential test looks at the interval, unless the caller names others.
LOOKS = (6, 12, 24)
#: Number of looks that share the error of the sequential test, even if a budget has fewer looks. A larger budget then
#: has the same intervals at its first looks, so it cannot decide differently where a smaller one has decided.
_SHARES = 5
_ERROR = 0.05


@dataclass(frozen=True)
class Proportion:
    """A proportion with the Wilson score interval (Wilson 1927, doi:10.1080/01621459.1927.10502953).

    The interval contains the true value with a probability of 1 - `error`, averaged over all true values (Brown, Cai
    and DasGupta 2001, doi:10.1214/ss/1009213286).

    Attributes:
        hits: the number of successes.
        n: the number of trials.
        error: the probability that the interval misses the true value.
    """

    hits: int
    n: int
    error: float = _ERROR

    @property
    def estimate(self) -> float:
        return self.hits / self.n if self.n else 0.0

    @property
    def low(self) -> float:
        return self._bounds()[0]

    @property
    def high(self) -> float:
        return self._bounds()[1]

    def _bounds(self) -> tuple[float, float]:
        if not self.n:
            return 0.0, 1.0
        # Imported here, because only judging and reports need it, and commands must start fast.
        from statistics import NormalDist

        z = NormalDist().inv_cdf(1 - self.error / 2)
        spread = z**2 / self.n
        middle = (self.estimate + spread / 2) / (1 + spread)
        half = z / (1 + spread) * sqrt(self.estimate * (1 - self.estimate) / self.n + spread / (4 * self.n))
        # Rounding must not put the estimate outside its interval.
        return max(min(middle - half, self.estimate), 0.0), min(max(middle + half, self.estimate), 1.0)

    def __str__(self) -> str:
        numbers = [f"{100 * share:.3g}%" for share in (self.estimate, 1 - self.error, self.low, self.high)]
        return "{} of {} ({}, {} interval {} to {})".format(self.hits, self.n, *numbers)

    def evidence(self) -> dict[str, float | int]:
        """Return the numbers for a finding's evidence."""
        return {
            "hits": self.hits,
            "n": self.n,
            "estimate": self.estimate,
            "low": self.low,
            "high": self.high,
            "confidence": 1 - self.error,
        }


class Exact(Proportion):
    """A proportion with the Clopper-Pearson interval (1934, doi:10.1093/biomet/26.4.404).

    For every true value, the interval misses it on either side with a probability of at most `error` / 2. Use it where
    a bound on the error is promised.
    """

    def _bounds(self) -> tuple[float, float]:
        return _lowest(self.hits, self.n, self.error / 2), 1 - _lowest(self.n - self.hits, self.n, self.error / 2)


@lru_cache(maxsize=256)
def _lowest(hits: int, n: int, tail: float) -> float:
    """Return the rate at which `hits` or more of `n` have the probability `tail`, or 0 if `hits` is 0."""
    if not hits:
        return 0.0
    ways = [lgamma(n + 1) - lgamma(k + 1) - lgamma(n - k + 1) for k in range(hits, n + 1)]
    low, high = 0.0, 1.0
    for _ in range(50):
        rate = (low + high) / 2
        won, lost = log(rate), log1p(-rate)
        if fsum(exp(way + k * won + (n - k) * lost) for k, way in enumerate(ways, hits)) < tail:
            low = rate
        else:
            high = rate
    return low


def settle(
    trial: Callable[[int], bool],
    threshold: float,
    looks: tuple[int, ...] = LOOKS,
    prefetch: Callable[[range], object] = lambda numbers: None,
    affords: Callable[[], bool] | None = None,
) -> tuple[bool | None, Proportion]:
    """Run `trial` 0, 1, 2, … until its rate is significantly above or below `threshold`.

    By Bonferroni's correction, all looks together err with a probability of at most 0.05. The correction is the same
    for up to five looks, so additional looks do not change an earlier decision.

    With `affords`, only a rate above the threshold matters: the trials also stop when no further success could show
    that, and when the budget does not allow one more.

    Args:
        trial: runs the trial of a number and returns whether it is a success.
        threshold: a rate from 0 to 1.
        looks: the numbers of trials after which the interval is compared with the threshold.
        prefetch: receives the numbers of the trials up to the next look, before the first of them runs; with `affords`
            after the first trial of all, which is often the only one.
        affords: whether the budget allows one more trial.

    Returns:
        True (above), False (below) or None (undecided), and the proportion.
    """
    hits = done = 0
    error = error_of_look(looks)
    rate = Exact(0, 0, error)
    for look in looks:
        if affords is None or done:
            prefetch(range(done, look))
        while done < look:
            if affords is not None and done and not affords():
                return None, Exact(hits, done, error)
            hits += trial(done)
            done += 1
            if affords is not None:
                if not any(_above(hits + later - done, later, threshold, error) for later in looks if later >= done):
                    return None, Exact(hits, done, error)
                if done == 1:
                    prefetch(range(done, look))
        rate = Exact(hits, done, error)
        if (verdict := is_above(rate, threshold)) is not None:
            return verdict, rate
    return None, rate


def error_of_look(looks: tuple[int, ...]) -> float:
    """Return the error of the interval at one look of :func:`settle`, by Bonferroni's correction."""
    return _ERROR / max(len(looks), _SHARES)


def is_above(rate: Proportion, threshold: float) -> bool | None:
    """Return whether a rate is significantly above (True) or below (False) a threshold; None if it is neither."""
    if rate.low > threshold:
        return True
    return False if rate.high < threshold else None


@lru_cache(maxsize=1024)
def _above(hits: int, n: int, threshold: float, error: float) -> bool:
    return is_above(Exact(hits, n, error), threshold) is True


def student(freedom: float) -> float:
    """Return the 0.975 quantile of Student's t distribution (two-sided 95%), accurate to three digits.

    The approximation is 26.7.5 of Abramowitz and Stegun (1964). Below three degrees of freedom, the value is exact for
    the degrees rounded down.

    Args:
        freedom: degrees of freedom. Below 1 the quantile is infinite.
    """
    if freedom < 1:
        return inf
    if freedom < 2:
        return tan(0.475 * pi)
    if freedom < 3:
        return 0.95 * sqrt(2 / (1 - 0.95**2))
    from statistics import NormalDist

    z = NormalDist().inv_cdf(0.975)
    terms = (
        (z**3 + z) / 4,
        (5 * z**5 + 16 * z**3 + 3 * z) / 96,
        (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384,
        (79 * z**9 + 776 * z**7 + 1482 * z**5 - 1920 * z**3 - 945 * z) / 92160,
    )
    return z + sum(term / freedom**power for power, term in enumerate(terms, 1))


class Mean(msgspec.Struct, frozen=True):
    """A mean with its standard error and Student's 95% interval, which is unbounded for a single value."""

    mean: float
    standard_error: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Mean:
        """Compute the mean of at least one value."""
        n = len(values)
        mean = sum(values) / n
        rests = [value - mean for value in values]
        # Untrusted code provides the values. fsum raises on infinities and pow on large numbers, so neither is used.
        error = sqrt(sum(rest * rest for rest in rests) / (n - 1) / n) if n > 1 else inf
        half = student(n - 1) * error
        return cls(mean, error, mean - half, mean + half)


def lead(ours: Sequence[float], others: Sequence[float]) -> Mean:
    """Return the mean of the paired differences `ours` - `others`.

    Raises:
        ValueError: the lengths differ.
    """
    return Mean.of([one - other for one, other in zip(ours, others, strict=True)])
