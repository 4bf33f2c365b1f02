"""# reward

## What it does
Looks at every reward of every episode: a real number (Python's or NumPy's; no array, no string, no None, no bool),
finite, and inside the contract's range for one step. Rewards that grow in size as the episode lasts, whatever the
agent does, and to at least 1, are growth without bound, be it from the start or from later on.

Where an episode is won and `info["is_success"]` says so, its return is held against that of doing nothing on the same
seed. If no win that was found pays anything, neither in its last step nor all in all, nor more than doing nothing, that
is a warning. Costs of time are fine: who wins pays less than who idles to the end.

## Why is this bad?
One NaN turns every weight of a network into NaN. A rare reward of a million swamps everything else that an agent
could learn, and a reward that grows with time teaches it to wait. A win that pays nothing is nothing to learn for.

## Example
```python
reward = self.hits / self.shots      # EC301 before the first shot: 0 / 0 with NumPy numbers
reward = 0.01 * self.steps ** 2      # EC304
```
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING

import msgspec

from envcraft.check import Check, Rule, Skip
from envcraft.plugins import hookimpl
from envcraft.rollout import Conditions, Rollout
from envcraft.shrink import repro
from envcraft.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace

_NUMBERS = ("int", "float", "numpy integer", "numpy floating")
_LONG = 80
_PARTS = 8
_GROWTH = 4.0
#: A reward of this size is one that most games pay, however it came about.
_USUAL = 1.0


class Reward(Check):
    name = "reward"
    rules = (
        Rule("EC301", "not-finite", "A reward is NaN or infinite.", "Guard the division or logarithm that gives it."),
        Rule("EC302", "not-a-number", "A reward is no real number.", "Return `float(reward)`."),
        Rule(
            "EC303", "out-of-range", "A reward lies outside the contract's range.", "Scale the rewards, or clip them."
        ),
        Rule(
            "EC304",
            "grows-without-bound",
            "Rewards grow in size as the episode lasts, whatever the agent does.",
            "Do not multiply a reward by time.",
        ),
        Rule(
            "EC305",
            "win-unpaid",
            "Winning pays nothing.",
            "Pay for the success that info reports.",
            Severity.WARNING,
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [*subject.played(), *subject.searches.explored()]
        if not any(trace.rewards for trace in traces):
            raise Skip("no episode came to a reward")
        seen: set[str] = set()
        for trace in traces:
            for finding in self.find(subject, trace):
                if finding.code not in seen:
                    seen.add(finding.code)
                    yield finding
        if "EC303" not in seen and "EC301" not in seen:
            yield from self._judge_growth(subject, traces)
        yield from self._judge_wins(subject, traces)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        if finding.code in ("EC304", "EC305"):
            return super().confirm(subject, finding)
        conditions = Conditions.from_json(finding.repro.conditions)
        trace = subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions))
        return next((found for found in self.find(subject, trace) if found.code == finding.code), None)

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        """What is wrong with single rewards of one trace, the first of each kind."""
        low, high = subject.contract.reward_range
        seen: set[str] = set()
        for step, (reward, kind) in enumerate(zip(trace.rewards, trace.reward_types, strict=True), 1):
            if kind not in _NUMBERS:
                code, words = "EC302", f"the reward of step {step} is a {kind}, not a number"
            elif not math.isfinite(reward):
                code, words = "EC301", f"the reward of step {step} is {reward}"
            elif not low <= reward <= high:
                code, words = "EC303", f"the reward of step {step} is {reward:g}, outside {low:g} to {high:g}"
            else:
                continue
            if code not in seen:
                seen.add(code)
                yield self.finding(
                    code,
                    f"{words} (under {trace.rollout.player})",
                    line=subject.line_of("step"),
                    repro=repro(trace.rollout.cut(step)),
                    step=step,
                    reward=reward,
                )

    def _judge_growth(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        long = [trace for trace in traces if trace.usable and trace.steps >= _LONG]
        grown = {id(trace): ratio for trace in long if (ratio := growth(trace.rewards)) is not None}
        if len(grown) < len(long):
            long = _late(long)
        if len(long) >= 3 and all(id(trace) in grown for trace in long):
            longest = max(long, key=lambda trace: trace.steps)
            sizes = [abs(reward) for reward in longest.rewards]
            yield self.finding(
                "EC304",
                f"rewards grow throughout each of {len(long)} long episodes, whatever is played: "
                f"{max(sizes[: _LONG // 2]):g} at the most in the first {_LONG // 2} steps, "
                f"{max(sizes):g} by step {longest.steps}",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(longest.steps)),
                episodes=len(long),
                growth=min(grown[id(trace)] for trace in long),
            )

    def _judge_wins(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        won = list({trace.rollout.key(): trace for trace in traces if trace.ended and trace.told}.values())
        if not won or subject.contract.noop is None:
            return
        if any(not trace.total <= 0 or not trace.rewards[-1] <= 0 for trace in won):
            return
        idle = subject.players.noop()
        seeds = list(dict.fromkeys(trace.rollout.seed for trace in won))
        idlers = subject.rollouts([msgspec.structs.replace(idle, seed=seed) for seed in seeds])
        idled = dict(zip(seeds, idlers, strict=True))
        # Where idling wins, too, it is losing that is paid for.
        if any(not trace.usable or trace.told for trace in idlers):
            return
        if any(trace.total > idled[trace.rollout.seed].total for trace in won):
            return
        shown = min(won, key=lambda trace: trace.steps)
        yield self.finding(
            "EC305",
            f"winning pays {shown.total:g} in {shown.steps} steps (under {shown.rollout.player}), and doing nothing "
            f"{idled[shown.rollout.seed].total:g}, with the same seed; so it is in each of {len(won)} episodes won",
            line=subject.line_of("step"),
            repro=repro(shown.rollout.cut(shown.steps)),
            won=len(won),
        )


def _late(traces: list[Trace]) -> list[Trace]:
    """The episodes of at least half the longest's steps, for growth that begins too late to show in the others: none
    where these say otherwise, or where none but those who hold one action live so long.
    """
    half = max(trace.steps for trace in traces) / 2
    long = [trace for trace in traces if trace.steps >= half]
    varied = {trace.rollout.seed for trace in long if len({str(action) for action in trace.actions}) > 1}
    return long if len(varied) > 1 and not any(_falls(trace.rewards) for trace in traces) else []


def growth(rewards: list[float]) -> float | None:
    """How many times larger rewards are in an episode's last eighth than in its first, when each tops the one before.

    None where they do not grow all the time, less than fourfold, or to no more than is usual. It may begin within the
    first half, before which nothing is paid: then the first eighth is that in which it begins.
    """
    sizes = _sizes(rewards)
    paid = sizes[next((number for number, size in enumerate(sizes) if size), _PARTS) :]
    if len(paid) < _PARTS // 2 or any(later <= earlier for earlier, later in pairwise(paid)):
        return None
    ratio = paid[-1] / paid[0]
    return ratio if ratio >= _GROWTH and paid[-1] >= _USUAL else None


def _falls(rewards: list[float]) -> bool:
    return any(later < earlier for earlier, later in pairwise(_sizes(rewards)))


def _sizes(rewards: list[float]) -> list[float]:
    """The median size of each eighth of an episode's rewards, so that single prizes do not count."""
    part = len(rewards) // _PARTS
    parts = (sorted(map(abs, rewards[number * part : (number + 1) * part])) for number in range(_PARTS))
    return [window[len(window) // 2] for window in parts]


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Reward()]
