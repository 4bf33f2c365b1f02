"""Proportions and means with their intervals, and tests that stop as soon as they are settled."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import exp, fsum, inf, lgamma, log, log1p, pi, sqrt, tan

import msgspec

#: Numbers of episodes after which a settling test looks.
LOOKS = (6, 12, 24)
#: So many looks share the error of a settling test, also where a budget ends before the last of them: its looks are the
#: first ones of a larger budget, which then settles the same where it is settled at all.
_SHARES = 5
_ERROR = 0.05


@dataclass(frozen=True)
class Proportion:
    """`hits` of `n` with the Wilson score interval (Wilson 1927, doi:10.1080/01621459.1927.10502953).

    It has the true value in it with a probability of 1 - `error` on average over what that value may be (Brown, Cai and
    DasGupta 2001, doi:10.1214/ss/1009213286).
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
        # Here, because only judging and reports need it and commands are to start fast.
        from statistics import NormalDist

        z = NormalDist().inv_cdf(1 - self.error / 2)
        spread = z**2 / self.n
        middle = (self.estimate + spread / 2) / (1 + spread)
        half = z / (1 + spread) * sqrt(self.estimate * (1 - self.estimate) / self.n + spread / (4 * self.n))
        # No rounding puts the estimate outside.
        return max(min(middle - half, self.estimate), 0.0), min(max(middle + half, self.estimate), 1.0)

    def __str__(self) -> str:
        numbers = [f"{100 * share:.3g}%" for share in (self.estimate, 1 - self.error, self.low, self.high)]
        return "{} of {} ({}, {} interval {} to {})".format(self.hits, self.n, *numbers)

    def evidence(self) -> dict[str, float | int]:
        """The numbers for a finding's evidence."""
        return {
            "hits": self.hits,
            "n": self.n,
            "estimate": self.estimate,
            "low": self.low,
            "high": self.high,
            "confidence": 1 - self.error,
        }


class Exact(Proportion):
    """The same with the interval of Clopper and Pearson (1934, doi:10.1093/biomet/26.4.404), which misses the true
    value on either side with a probability of `error` / 2 at the most, whatever it is: where an error is promised.
    """

    def _bounds(self) -> tuple[float, float]:
        return _lowest(self.hits, self.n, self.error / 2), 1 - _lowest(self.n - self.hits, self.n, self.error / 2)


@lru_cache(maxsize=256)
def _lowest(hits: int, n: int, tail: float) -> float:
    """The rate at which `hits` or more come with the probability `tail`; 0 where there are none."""
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
) -> tuple[bool | None, Proportion]:
    """Run `trial` 0, 1, 2, … until its rate is settled to lie above or below `threshold`.

    `prefetch` receives the numbers of the trials up to the next look, before the first of them runs.

    Gives True (above), False (below) or None (the last look settles nothing), and the proportion. The interval at each
    look is wide enough that all looks together err at most once in twenty, by Bonferroni. Up to five looks it is the
    same at the same look, so that more of them change nothing that is settled.
    """
    hits = done = 0
    error = _ERROR / max(len(looks), _SHARES)
    rate = Exact(0, 0, error)
    for look in looks:
        prefetch(range(done, look))
        while done < look:
            hits += trial(done)
            done += 1
        rate = Exact(hits, done, error)
        if rate.low > threshold:
            return True, rate
        if rate.high < threshold:
            return False, rate
    return None, rate


def student(freedom: float) -> float:
    """The 0.975 quantile of Student's t, for two-sided 95%, right to three digits.

    By Abramowitz and Stegun (1964), 26.7.5, and exactly for less than three degrees of freedom, which are rounded down;
    for less than one there is none.
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
    """A mean with its standard error and the 95% interval of Student's t, which a single value has no bounds for."""

    mean: float
    standard_error: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Mean:
        """Of at least one value."""
        n = len(values)
        mean = sum(values) / n
        rests = [value - mean for value in values]
        # Of what untrusted code gives nothing may raise, neither infinities, as in fsum, nor large numbers, as in pow.
        error = sqrt(sum(rest * rest for rest in rests) / (n - 1) / n) if n > 1 else inf
        half = student(n - 1) * error
        return cls(mean, error, mean - half, mean + half)


def lead(ours: Sequence[float], others: Sequence[float]) -> Mean:
    """By how much the mean of `ours` lies above that of `others`, whose values go together one by one."""
    return Mean.of([one - other for one, other in zip(ours, others, strict=True)])
