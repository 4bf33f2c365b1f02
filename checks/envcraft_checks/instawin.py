"""# instawin

## What it does
Plays at random until it is settled whether random play consistently wins (more than 80% of episodes): by
`is_success` where info gives it; else by a positive return at a terminated end that no other play clearly beats. And
looks whether every policy earns the very same positive return, so that reward is paid regardless of play; where info
tells of success, only if some episode had it. Play that comes to no end counts there where it earns clearly more.

With `--policy FILE` the privileged policy is other play, too: its actions are stepped again without it.

## Why is this bad?
Where random play wins there is nothing to learn, and a score on it says nothing about an agent.

## Example
```python
if self.steps > 20:                      # EC601: surviving for 20 steps wins, and nothing can kill
    terminated, info["is_success"] = True, True
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.check import Check, Rule, Skip
from envcraft.plugins import hookimpl
from envcraft.shrink import repro
from envcraft.stats import settle
from envcraft.verdict import Finding

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

_CLEARLY = 1.25
BY_SIGN = ": each ends with a positive return; info tells no success"


class InstaWin(Check):
    name = "instawin"
    rules = (
        Rule("EC601", "random-wins", "Random play consistently wins.", "Make winning depend on what the agent does."),
        Rule(
            "EC602",
            "paid-regardless",
            "The same positive reward is paid whatever the agent does.",
            "Pay for what the agent achieves, not for the passing of time.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if not any(trace.ended for trace in subject.played()):
            raise Skip("no episode ends by itself")
        if wins_told(subject):
            yield from self._judge_random(subject)
        yield from self._judge_paid(subject)

    def _judge_random(self, subject: Subject) -> Iterator[Finding]:
        consistently = subject.contract.consistently
        verdict, rate = settle(
            lambda number: bool(subject.random(number).success),
            consistently,
            subject.budget.looks,
            lambda numbers: subject.foresee(map(subject.players.random, numbers)),
        )
        if verdict is not True:
            return
        wins = [trace for trace in map(subject.random, range(rate.n)) if trace.success]
        by_sign = not all(trace.told is not None for trace in wins)
        if by_sign:
            usual = sum(trace.total for trace in wins) / len(wins)
            best = max(
                trace.total for trace in [*subject.played(), *subject.searches.explored(), *subject.privileged()]
            )
            if best > max(_CLEARLY * usual, usual + 1e-9):
                return
        shortest = min(wins, key=lambda trace: trace.steps)
        yield self.finding(
            "EC601",
            f"random play wins {rate}, more than {100 * consistently:g}%, in {shortest.steps} steps at the least"
            f"{BY_SIGN if by_sign else ''}",
            line=subject.line_of("step"),
            repro=repro(shortest.rollout.cut(shortest.steps)),
            rate=rate.evidence(),
        )

    def _judge_paid(self, subject: Subject) -> Iterator[Finding]:
        traces = [trace for trace in subject.played() if trace.usable]
        by_seed: dict[int, list[Trace]] = {}
        for trace in [*traces, *(trace for trace in subject.searches.explored() if trace.ended)]:
            by_seed.setdefault(trace.rollout.seed, []).append(trace)
        found = [trace for same in by_seed.values() for trace in same]
        if any(trace.told is not None for trace in found) and not any(trace.told for trace in found):
            # What nobody has seen may be paid otherwise.
            return
        widest = max(by_seed.values(), key=len)
        policies = {trace.rollout.player for trace in widest}
        earned = widest[0].total
        if earned <= 0 or len(policies) < 4 or any(not _same_returns(same) for same in by_seed.values()):
            return
        others = [
            trace for trace in [*subject.searches.explored(), *subject.privileged()] if trace.rollout.seed in by_seed
        ]
        if any(_paid_otherwise(trace, by_seed[trace.rollout.seed]) for trace in others):
            return
        yield self.finding(
            "EC602",
            f"all {len(policies)} policies earn the same on each seed: {earned:g} on seed {widest[0].rollout.seed}",
            line=subject.line_of("step"),
            repro=repro(widest[0].rollout.cut(widest[0].steps)),
            policies=len(policies),
            episodes=len(traces),
            earned=earned,
        )


def wins_told(subject: Subject) -> bool:
    """Whether anything tells a win: the return's sign, or else some episode's info."""
    return subject.contract.success.sign or any(trace.told is not None for trace in subject.played())


def _same_returns(traces: list[Trace]) -> bool:
    return len({round(trace.total, 6) for trace in traces}) == 1


def _paid_otherwise(trace: Trace, same: list[Trace]) -> bool:
    """Whether a trace earns another return than those of its seed, which earn the same."""
    if trace.ended:
        return not _same_returns([trace, *same])
    # Play that comes to no end, where a goal is all that ends an episode, is not paid as play that does.
    return trace.usable and trace.total > max(_CLEARLY * same[0].total, same[0].total + 1e-9)


@hookimpl
def envcraft_checks() -> list[Check]:
    return [InstaWin()]
