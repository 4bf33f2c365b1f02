"""# reward

## What it does
Checks every reward of every episode. A reward must be a real number of Python or NumPy (not an array, string, None or
bool), finite, and inside the contract's range for one step. Rewards grow without bound if their size rises over the
whole episode, under every policy, at least fourfold and to at least 1. The growth may start in the first half.

If `info["is_success"]` reports wins, the check compares the return of each win with the return of doing nothing on the
same seed. It warns if no win has a positive last reward, a positive return, or a higher return than doing nothing.
Step costs are fine: they make a win cheaper than idling to the end.

## Why is this bad?
One NaN turns every weight of a network into NaN. A rare reward of a million outweighs everything else that an agent
could learn, and a reward that grows with time teaches the agent to wait. An agent has no reason to learn a win that
pays nothing.

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

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro, shrunk
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_NUMBERS = ("int", "float", "numpy integer", "numpy floating")
_LONG = 80
_PARTS = 8
_GROWTH = 4.0
#: Most games pay rewards of this size.
_USUAL = 1.0


class Reward(Check):
    name = "reward"
    rules = (
        Rule(
            "EC301", "not-finite", "A reward is NaN or infinite.", "Guard the division or logarithm that produces it."
        ),
        Rule("EC302", "not-a-number", "A reward is not a real number.", "Return `float(reward)`."),
        Rule(
            "EC303",
            "out-of-range",
            "A reward is outside the contract's range.",
            "Scale the rewards, or clip them.",
            waiver="reward-range = [LOW, HIGH]",
        ),
        Rule(
            "EC304",
            "grows-without-bound",
            "Rewards grow with the length of the episode under every policy.",
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
            raise Skip("no episode has a reward")
        seen: set[str] = set()
        for trace in traces:
            for finding in self.find(subject, trace):
                if finding.code not in seen:
                    seen.add(finding.code)
                    yield shrunk(subject, trace.rollout, finding, lambda played: self.find(subject, played))
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
        """Judge the single rewards of one trace, and report the first of each kind."""
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
        long = _long(traces)
        grown = {id(trace): ratio for trace in long if (ratio := growth(trace.rewards)) is not None}
        if late := len(grown) < len(long):
            if any(_falls(trace.rewards) for trace in long):
                return
            # Growth may begin too late for those that are shorter, or cut.
            long = [trace for trace in long if trace.ended and 2 * trace.steps >= max(each.steps for each in long)]
        least = max((trace.steps for trace in long), default=0) // 2 if late else _LONG
        more = subject.episodes.more_whole()
        while long and all(id(trace) in grown for trace in long) and not _enough(long, late):
            if (trace := next(more, None)) is None:
                return
            if trace.usable and trace.steps >= least and trace not in long:
                long.append(trace)
                if (ratio := growth(trace.rewards)) is not None:
                    grown[id(trace)] = ratio
        if long and all(id(trace) in grown for trace in long):
            longest = max(long, key=lambda trace: trace.steps)
            sizes = [abs(reward) for reward in longest.rewards]
            yield self.finding(
                "EC304",
                f"rewards grow throughout each of {len(long)} long episodes under every policy: "
                f"at most {max(sizes[: _LONG // 2]):g} in the first {_LONG // 2} steps, "
                f"{max(sizes):g} by step {longest.steps}",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(longest.steps)),
                episodes=len(long),
                growth=min(grown[id(trace)] for trace in long),
            )

    def _judge_wins(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        won = list({trace.rollout.key(): trace for trace in traces if trace.ended and trace.reported_success}.values())
        if not won or subject.contract.noop is None:
            return
        if any(not trace.total <= 0 or not trace.rewards[-1] <= 0 for trace in won):
            return
        idled: dict[int, Trace] = {}
        for trace in won:
            seed = trace.rollout.seed
            if seed not in idled:
                idled[seed] = subject.rollout(msgspec.structs.replace(subject.probes.noop(), seed=seed))
            # If idling wins as well, the reward is for losing.
            if not idled[seed].usable or idled[seed].reported_success or trace.total > idled[seed].total:
                return
        shown = min(won, key=lambda trace: trace.steps)
        yield self.finding(
            "EC305",
            f"winning pays {shown.total:g} in {shown.steps} steps (under {shown.rollout.player}), and doing nothing "
            f"{idled[shown.rollout.seed].total:g} on the same seed; none of {len(won)} won episodes pays more",
            line=subject.line_of("step"),
            repro=repro(shown.rollout.cut(shown.steps)),
            won=len(won),
        )


def _long(traces: list[Trace]) -> list[Trace]:
    return [trace for trace in traces if trace.usable and trace.steps >= _LONG]


def _enough(long: list[Trace], late: bool) -> bool:
    """Whether so many episodes show growth; if it begins late, under varied actions on two seeds, too."""
    varied = {trace.rollout.seed for trace in long if len({str(action) for action in trace.actions}) > 1}
    return len(long) >= 3 and (not late or len(varied) > 1)


def growth(rewards: list[float]) -> float | None:
    """How many times larger rewards are in the last eighth of an episode than in the first eighth that pays.

    Args:
        rewards: all rewards of an episode, shape ``(steps,)``.

    Returns:
        The ratio; None if some eighth does not exceed the one before, if growth starts in the second half, or if the
        ratio or the last rewards are small.
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
    """The median size of rewards in each eighth of an episode: single large rewards do not count."""
    part = len(rewards) // _PARTS
    parts = (sorted(map(abs, rewards[number * part : (number + 1) * part])) for number in range(_PARTS))
    return [window[len(window) // 2] for window in parts]


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Reward()]
