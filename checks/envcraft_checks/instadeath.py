"""# instadeath

## What it does
Does nothing, on one seed after another, until it is settled whether this loses at once on more than 50% of seeds. To
lose at once is to terminate within 30 steps without success. Later losses, truncations and wins do not count.

## Why is this bad?
An untrained agent acts at random. If every early episode ends before it can act, it sees only the start and the loss.

## Example
```python
self.bird_y, self.velocity = 10, 3.0     # EC701: falls to the ground in 14 steps
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.judging.statistics import settle
from envcraft.model.verdict import Finding
from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_MOST = 0.5


class InstaDeath(Check):
    name = "instadeath"
    rules = (
        Rule(
            "EC701",
            "idle-loses",
            "Doing nothing loses at once on most seeds.",
            "Give the agent some steps before it can lose.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        within = subject.contract.at_once

        def lost(number: int) -> bool:
            return _lost(subject.noop(number, within))

        def prefetch(numbers: range) -> None:
            subject.prefetch(subject.probes.noop(number, within) for number in numbers)

        verdict, rate = settle(lost, _MOST, subject.budget.looks, prefetch, lambda: subject.affords(within))
        # The check termination reports episodes that end before play is possible.
        if verdict is True:
            shortest = min((subject.noop(number, within) for number in range(rate.n)), key=lambda trace: trace.steps)
            yield self.finding(
                "EC701",
                f"doing nothing loses within {within} steps on {rate} seeds, more than {100 * _MOST:g}%, and at the "
                f"earliest at step {shortest.steps}",
                line=subject.line_of("step"),
                repro=repro(shortest.rollout.cut(shortest.steps)),
                rate=rate.evidence(),
            )


def _lost(trace: Trace) -> bool:
    return bool(trace.terminated) and trace.terminated[-1] and not trace.success


@hookimpl
def envcraft_checks() -> list[Check]:
    return [InstaDeath()]
