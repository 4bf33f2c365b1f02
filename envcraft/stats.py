"""Proportions with their intervals, and tests that stop as soon as they are settled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

#: Two-sided 95% over three looks, by Bonferroni: the normal quantile of 1 - 0.05 / 6.
Z = 2.394
#: Numbers of episodes after which a settling test looks.
LOOKS = (6, 12, 24)


@dataclass(frozen=True)
class Proportion:
    """`hits` of `n` with the Wilson score interval (Wilson 1927, doi:10.1080/01621459.1927.10502953)."""

    hits: int
    n: int
    z: float = Z

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
        spread = self.z**2 / self.n
        middle = (self.estimate + spread / 2) / (1 + spread)
        half = self.z / (1 + spread) * sqrt(self.estimate * (1 - self.estimate) / self.n + spread / (4 * self.n))
        return max(middle - half, 0.0), min(middle + half, 1.0)

    def __str__(self) -> str:
        return f"{self.hits} of {self.n} ({self.estimate:.0%}, interval {self.low:.0%} to {self.high:.0%})"

    def evidence(self) -> dict[str, float | int]:
        """The numbers for a finding's evidence."""
        return {"hits": self.hits, "n": self.n, "estimate": self.estimate, "low": self.low, "high": self.high}


def settle(
    trial: Callable[[int], bool],
    threshold: float,
    looks: tuple[int, ...] = LOOKS,
    foresee: Callable[[range], object] = lambda numbers: None,
) -> tuple[bool | None, Proportion]:
    """Run `trial` 0, 1, 2, … until its rate is settled to lie above or below `threshold`.

    `foresee` is told which trials will be run up to the next look, before the first of them.

    Gives True (above), False (below) or None (the last look settles nothing), and the proportion. The interval at each
    look is wide enough that all looks together err at most once in twenty.
    """
    hits = done = 0
    # Two-sided 95% over all looks, by Bonferroni.
    # Here, because only judging needs it and commands are to start fast.
    from statistics import NormalDist

    z = NormalDist().inv_cdf(1 - 0.05 / (2 * len(looks)))
    rate = Proportion(0, 0, z)
    for look in looks:
        foresee(range(done, look))
        while done < look:
            hits += trial(done)
            done += 1
        rate = Proportion(hits, done, z)
        if rate.low > threshold:
            return True, rate
        if rate.high < threshold:
            return False, rate
    return None, rate
