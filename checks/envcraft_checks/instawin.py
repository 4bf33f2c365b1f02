"""# instawin

## What it does
Plays at random until it is settled whether random play consistently wins, that is in more than 80% of episodes. A win
is `is_success` if info reports it; otherwise it is a positive return at a terminated end that no other play clearly
exceeds. If that return mostly pays for each step, it measures survival and not wins, and the finding is a warning.
Random play finds the way out of any maze in the end. The finding is also a warning if no step limit ends an episode,
and half of the wins take more than 20 steps and three times as many as the shortest: such a class is often registered
with `max_episode_steps`.

It is the same defect if info reports success at every step of every episode.

The check also compares the returns of all policies: if each earns the same positive return, the reward does not depend
on play. If info reports success, the check needs an episode with success for this. An episode without an end counts
only if it earns clearly more, which shows that play matters.

With `--policy FILE` the check also plays the actions of the privileged policy.

If the code reads the clock and uses the time in the game, the speed of the machine decides how often play wins. The
check is then skipped instead of a finding, unless every episode reports success at every step. The same holds if a
generator with a fixed seed, which reset() does not seed again, makes all fresh episodes draw the same numbers.

## Why is this bad?
If random play wins, an agent has nothing to learn, and its score says nothing about it.

## Example
```python
if self.steps > 20:                      # EC601: surviving for 20 steps wins, and nothing can kill
    terminated, info["is_success"] = True, True
```
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.errors import Skip, Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.judging.statistics import settle
from envcraft.model.verdict import Finding
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .linting.clock import timed
from .linting.generators import drawn_alike

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_CLEARLY = 1.25
#: The share of a return that payments for each step make up if it counts survival.
_MOSTLY = 0.8
#: Policies that must be paid the same on one seed.
_POLICIES = 4
#: Episodes, on two seeds at least, whose every info must report success.
_TOLD = 6
#: Random play wanders to a win if half of its wins take this many times the steps of the shortest, and more than these.
_WANDERS, _LONG = 3, 20
_NO_LIMIT = (
    "; no step limit ends an episode here: if the environment is registered with one, judge its id, or name a wrapper "
    "with --wrap"
)
BY_SIGN = ": each ends with a positive return; info reports no success"


class InstaWin(Check):
    name = "instawin"
    rules = (
        Rule("EC601", "random-wins", "Random play consistently wins.", "Make winning depend on the agent's actions."),
        Rule(
            "EC602",
            "paid-regardless",
            "The same positive reward is paid under every policy.",
            "Reward achievements of the agent, not the passing of time.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        if not any(trace.usable and trace.steps for trace in subject.played()):
            raise Undecided("each episode raises an error or has no step")
        if not any(trace.ended for trace in subject.played()):
            raise Skip("no episode ends by itself")
        found: list[Finding] = []
        unsettled = ""
        if wins_known(subject):
            found, unsettled = self._judge_random(subject)
            if not found:
                yield from self._judge_told(subject)
        found += self._judge_paid(subject)
        if found:
            timed(subject)
            drawn_alike(subject)
        yield from found
        if unsettled:
            raise Undecided(unsettled)

    def _judge_random(self, subject: Subject) -> tuple[list[Finding], str]:
        """Return the finding, or why it is unsettled whether there is one."""
        consistently = subject.contract.consistently
        verdict, rate = settle(
            lambda number: bool(subject.random(number).success),
            consistently,
            subject.episodes.looks,
            lambda numbers: subject.prefetch(map(subject.probes.random, numbers)),
            lambda: subject.affords(subject.random(0).steps),
        )
        wins = [trace for trace in map(subject.random, range(rate.n)) if trace.success]
        by_sign = not all(trace.reported_success is not None for trace in wins)
        if verdict is not True:
            if verdict is False or by_sign or len(wins) < rate.n or rate.n == subject.episodes.looks[-1]:
                return [], ""
            return [], (
                f"random play wins all of {plural(rate.n, 'episode')}, and the budget {subject.budget.name} "
                f"allows too few episodes to settle whether it wins more than {100 * consistently:g}%"
            )
        if by_sign:
            usual = sum(trace.total for trace in wins) / len(wins)
            best = max(
                trace.total for trace in [*subject.played(), *subject.searches.explored(), *subject.privileged()]
            )
            if best > max(_CLEARLY * usual, usual + 1e-9):
                return [], ""
        shortest = min(wins, key=lambda trace: trace.steps)
        median = statistics.median_low(trace.steps for trace in wins)
        wanders = _is_unlimited(subject) and median > max(_WANDERS * shortest.steps, _LONG)
        found = self.finding(
            "EC601",
            f"random play wins {rate}, more than {100 * consistently:g}%, half of the time within "
            f"{plural(median, 'step')}{BY_SIGN if by_sign else ''}{_NO_LIMIT if wanders else ''}",
            line=subject.line_of("step"),
            repro=repro(shortest.rollout.cut(shortest.steps)),
            rate=rate.evidence(),
        )
        return [found.as_warning() if wanders or (by_sign and all(map(counts_survival, wins))) else found], ""

    def _judge_told(self, subject: Subject) -> list[Finding]:
        """Report a success that every info of every episode reports, from the reset on."""
        traces = [trace for trace in [*subject.played(), *subject.searches.explored()] if trace.usable and trace.steps]
        seeds = {trace.rollout.seed for trace in traces}
        if len(seeds) < 2 or len(traces) < _TOLD or not all(map(_always_told, traces)):
            return []
        first = traces[0]
        found = self.finding(
            "EC601",
            f"info reports success at every step of all {len(traces)} episodes, under every policy",
            line=subject.line_of("step"),
            repro=repro(first.rollout.cut(1)),
            episodes=len(traces),
        )
        return [found]

    def _judge_paid(self, subject: Subject) -> Iterator[Finding]:
        traces = self._paid_alike(subject)
        if not traces:
            return
        by_seed: dict[int, list[Trace]] = {}
        for trace in [*traces, *(trace for trace in subject.searches.explored() if trace.ended)]:
            by_seed.setdefault(trace.rollout.seed, []).append(trace)
        found = [trace for same in by_seed.values() for trace in same]
        if any(trace.reported_success is not None for trace in found) and not any(
            trace.reported_success for trace in found
        ):
            # No episode has shown how a success is paid.
            return
        widest = max(by_seed.values(), key=len)
        policies = {trace.rollout.player for trace in widest}
        earned = widest[0].total
        if earned <= 0 or len(policies) < _POLICIES or any(not _same_returns(same) for same in by_seed.values()):
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

    def _paid_alike(self, subject: Subject) -> list[Trace]:
        """Whole episodes, on the first seed under several policies; none if two policies are paid differently."""
        first = subject.episodes.whole[0]
        ended = [trace for trace in subject.played() if trace.ended]
        known = {trace.rollout.seed: trace for trace in reversed(ended)}
        for trace in subject.played():
            other = known.get(trace.rollout.seed)
            if trace.usable and other is not None and _paid(trace, trace.steps) != _paid(other, trace.steps):
                return []
        if not first.ended or first.total <= 0:
            return []
        last = subject.joint_actions[-1]
        others = [subject.probes.hold(last), subject.probes.sticky(0), subject.probes.hold(subject.joint_actions[1])]
        for rollout in others:
            if len({trace.rollout.player for trace in ended if trace.rollout.seed == first.rollout.seed}) >= _POLICIES:
                break
            if not subject.affords(len(rollout.actions)):
                return []
            if not (whole := subject.rollout(rollout)).ended or not _same_returns([whole, first]):
                return []
            ended.append(whole)
        return list({trace.rollout.key(): trace for trace in ended}.values())


def _is_unlimited(subject: Subject) -> bool:
    """Whether neither the contract nor the environment limits the steps of an episode."""
    contract = subject.contract
    limited = contract.limit is not None or "limit" in contract.adapter
    return not limited and not any(any(trace.truncated) for trace in subject.played())


def _always_told(trace: Trace) -> bool:
    """Whether the infos of all steps that the trace has kept report success, the first and the last one among them."""
    key = trace.rule.key
    if not (trace.reported_success and trace.info(1).get(key)):
        return False
    return all(trace.info(step).get(key, True) for step in range(1, trace.steps))


def wins_known(subject: Subject) -> bool:
    """Whether wins are known: from the sign of the return, or from the info of some episode."""
    return subject.contract.success.sign or any(trace.reported_success is not None for trace in subject.played())


def counts_survival(trace: Trace) -> bool:
    """Whether the return is mostly a payment for each step, under any play."""
    return statistics.median(trace.rewards) * trace.steps >= _MOSTLY * trace.total > 0


def _paid(trace: Trace, steps: int) -> float:
    """The rewards of the first steps together."""
    return round(sum(trace.rewards[:steps]), 6)


def _same_returns(traces: list[Trace]) -> bool:
    return len({round(trace.total, 6) for trace in traces}) == 1


def _paid_otherwise(trace: Trace, same: list[Trace]) -> bool:
    """Whether a trace earns a different return than the other traces of its seed, which all earn the same."""
    if trace.ended:
        return not _same_returns([trace, *same])
    # If only a goal ends an episode, play that reaches no end is not paid like play that does.
    return trace.usable and trace.total > max(_CLEARLY * same[0].total, same[0].total + 1e-9)


@hookimpl
def envcraft_checks() -> list[Check]:
    return [InstaWin()]
