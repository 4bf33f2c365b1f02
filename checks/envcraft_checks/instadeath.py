"""# instadeath

## What it does
Does nothing, on one seed after another, until it is settled whether that loses at once on most of them (more than 50%):
terminated within 30 steps without success. Later losses, truncations and wins do not count.

## Why is this bad?
Early in training an agent does not know what to do. Where every early episode is over before it can act, it sees
nothing but the start and the loss.

## Example
```python
self.bird_y, self.velocity = 10, 3.0     # EC701: falls to the ground in 14 steps
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.check import Check, Rule
from envcraft.plugins import hookimpl
from envcraft.shrink import repro
from envcraft.stats import settle
from envcraft.verdict import Finding

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

_MOST = 0.5


class InstaDeath(Check):
    name = "instadeath"
    rules = (
        Rule(
            "EC701",
            "idle-loses",
            "Doing nothing loses at once on most seeds.",
            "Give the agent a moment before anything can kill it.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        within = subject.contract.at_once

        def lost(number: int) -> bool:
            return _lost(subject.noop(number, within))

        def foresee(numbers: range) -> None:
            subject.foresee(subject.players.noop(number, within) for number in numbers)

        verdict, rate = settle(lost, _MOST, subject.budget.looks, foresee)
        # An episode that is over before anything can be done is the check termination's.
        if verdict is True:
            shortest = min((subject.noop(number, within) for number in range(rate.n)), key=lambda trace: trace.steps)
            yield self.finding(
                "EC701",
                f"doing nothing loses within {within} steps on {rate} seeds, more than {100 * _MOST:g}%, at step "
                f"{shortest.steps} at the earliest",
                line=subject.line_of("step"),
                repro=repro(shortest.rollout.cut(shortest.steps)),
                rate=rate.evidence(),
            )


def _lost(trace: Trace) -> bool:
    return bool(trace.terminated) and trace.terminated[-1] and not trace.success


@hookimpl
def envcraft_checks() -> list[Check]:
    return [InstaDeath()]
