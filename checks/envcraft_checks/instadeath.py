"""# instadeath

## What it does
Does nothing, on one seed after another, until it is settled whether this loses at once on more than 50% of seeds
(EC701). An episode is lost at once if it terminates within 30 steps without success. Later losses, truncations and
wins do not count: a loss that is truncated is the defect EC510, and counts here after the fix. A game that is short by
design does not count either: doing nothing ends at the same step on every seed, no play lasts longer, and the return
depends on the actions. Nor does a time limit that terminates, which is the defect EC502.

Plays a few random steps on many seeds. If an episode ends at once, the check tries other actions on the same seed. A
seed is degenerate if these also end the episode within 3 steps, so that nothing can be played. Degenerate seeds are an
error (EC702) if they are at least 10% of the seeds and the 95% interval of their share lies above 5%, unless episodes
on other seeds are as short. They are a warning (EC703) if the interval lies above 2%.

## Why is this bad?
An untrained agent acts at random. If every early episode ends before it can act, it sees only the start and the loss. A
degenerate seed gives a reward for no decision, which is noise in training and in every score.

## Example
```python
self.bird_y, self.velocity = 10, 3.0     # EC701: falls to the ground in 14 steps
self.goal = self.np_random.integers(9)   # EC702: one game in nine starts on the goal
```
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from itertools import repeat
from typing import TYPE_CHECKING

from envcraft.errors import Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.judging.statistics import Exact, settle
from envcraft.model.rollout import Conditions, Episode, Rollout
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl

from .linting.limits import terminates_at
from .linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The share of seeds on which doing nothing loses at once, above which that is a defect.
MOST = 0.5
#: At least one of so many seeds must have a step.
_TRIED = 3
#: The shares of degenerate seeds that are surely exceeded where that is a warning and an error, and the least estimate
#: of an error.
_SOME, _FEW, _MANY = 0.02, 0.05, 0.1
#: Steps within which a degenerate seed's episode is over, and the random plays that are tried besides the first.
_AT_ONCE, _DRAWN = 3, 2
#: Steps in which each action is held on the suspects, and the fewest actions that are.
_STEPS, _FEWEST = 1_500, 6
#: Steps that an episode on other seeds lasts at least.
_PLAYED = 12
#: Degenerate seeds that are played once more, each in a process of its own.
_SHOWN = 3


class InstaDeath(Check):
    name = "instadeath"
    rules = (
        Rule(
            "EC701",
            "idle-loses",
            "Doing nothing loses at once on most seeds.",
            "Give the agent some steps before it can lose.",
        ),
        Rule(
            "EC702",
            "degenerate-seeds",
            "On many seeds the episode ends at once under every action.",
            "Draw the start again in reset() until it is neither won nor lost.",
        ),
        Rule(
            "EC703",
            "some-degenerate-seeds",
            "On some seeds the episode ends at once under every action.",
            "Draw the start again in reset() until it is neither won nor lost.",
            Severity.WARNING,
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        degenerate = self._judge_seeds(subject)
        if degenerate is not None:
            yield degenerate
            return
        within = subject.contract.at_once
        if not any(trace.usable and trace.steps for trace in map(subject.noop, range(_TRIED), repeat(within))):
            raise Undecided("each episode raises an error or has no step")

        def lost(number: int) -> bool:
            return _lost(subject.session.idle(number) or subject.noop(number, within))

        def prefetch(numbers: range) -> None:
            missing = [number for number in numbers if subject.session.idle(number) is None]
            subject.prefetch(subject.probes.noop(number, within) for number in missing)

        verdict, rate = settle(lost, MOST, subject.episodes.looks, prefetch, lambda: subject.affords(within))
        # The check termination reports episodes that end before play is possible.
        if verdict is True:
            # The session's episodes follow others, so all are played again.
            idle = [subject.noop(number, within) for number in range(rate.n)]
            shortest = min((trace for trace in idle if _lost(trace)), key=lambda trace: trace.steps, default=None)
            if shortest is None or _short_by_design(subject, idle) or _is_time_limit(subject, idle):
                return
            yield self.finding(
                "EC701",
                f"doing nothing loses within {within} steps on {rate} seeds, more than {100 * MOST:g}%, and at the "
                f"earliest at step {shortest.steps}",
                line=subject.line_of("step"),
                repro=repro(shortest.rollout.cut(shortest.steps)),
                rate=rate.evidence(),
            )

    def _judge_seeds(self, subject: Subject) -> Finding | None:
        varied = subject.session.varied
        suspects = [trace for trace in varied if trace.ended and trace.steps <= _AT_ONCE]
        if degenerate_code(Exact(len(suspects), len(varied))) is None:
            return None
        suspects = _over_at_once(subject, suspects)
        rate = Exact(len(suspects), len(varied))
        if (code := degenerate_code(rate)) is None:
            return None
        seeds, usual = {trace.rollout.seed for trace in suspects}, _usual(subject)
        alone = [subject.rollout(trace.rollout.under(Conditions())) for trace in suspects[:_SHOWN]]
        if usual < _PLAYED or not all(trace.ended and trace.steps <= _AT_ONCE for trace in alone):
            return None
        won = sum(bool(trace.success) for trace in suspects)
        return self.finding(
            code,
            f"on {rate} seeds the episode is over within {_AT_ONCE} steps under every action ({won} are won), while it "
            f"lasts {usual:.0f} steps on others",
            line=subject.line_of("reset"),
            repro=repro(alone[0].rollout.cut(alone[0].steps)),
            rate=rate.evidence(),
            won=won,
            usual=usual,
            seeds=sorted(seeds)[:20],
        )


def degenerate_code(rate: Exact) -> str | None:
    """Return the code of a share of degenerate seeds; None if it may be as small as the chance of a few games."""
    if rate.low <= _SOME:
        return None
    return "EC702" if rate.low > _FEW and rate.estimate >= _MANY else "EC703"


def _usual(subject: Subject) -> float:
    """How long an episode can last on the seeds that are not degenerate, by short random play and what else was played
    on them.
    """
    going = [trace.rollout.seed for trace in subject.session.varied if not trace.ended][:_SHOWN]
    first = [subject.episode_seed(0), *going]
    tried = [subject.random(0), *(subject.rollout(_short(subject, seed)) for seed in going)]
    longest = {
        seed: max(trace.steps for trace in [*tried, *subject.played()] if trace.rollout.seed == seed) for seed in first
    }
    lasting = [steps for steps in longest.values() if steps > _AT_ONCE]
    return statistics.median(lasting) if lasting else 0.0


def _short(subject: Subject, seed: int) -> Rollout:
    from envcraft.judging import actions

    length = subject.contract.at_once
    return Rollout(seed, actions.random_actions(subject.action_space, seed, length), player="random play")


def _over_at_once(subject: Subject, suspects: list[Trace]) -> list[Trace]:
    """Those of some short episodes that end at once on the same seed under other actions, too."""
    from envcraft.judging import actions

    space, joint = subject.action_space, subject.joint_actions
    count = max(_STEPS // (_AT_ONCE * len(suspects)), _FEWEST)
    held = [[action] * _AT_ONCE for action in joint[:: max(len(joint) // count, 1)]]
    episodes = []
    for trace in suspects:
        seed = trace.rollout.seed
        drawn = [actions.random_actions(space, seed + 1_009 * number, _AT_ONCE) for number in range(1, _DRAWN + 1)]
        episodes += [Episode(seed, tried) for tried in (*held, *drawn)]
    tried = subject.rollout(Rollout(suspects[0].rollout.seed, [], Conditions(before=episodes, recorded=True))).before
    each = len(episodes) // len(suspects)
    alike = [tried[at : at + each] for at in range(0, len(tried), each)]
    return [
        trace
        for trace, others in zip(suspects, alike, strict=False)
        if len(others) == each and all(other.ended for other in others)
    ]


def _short_by_design(subject: Subject, idle: list[Trace]) -> bool:
    """Whether a clock ends every episode that is not over sooner, and the actions decide what an episode returns."""
    played = [*subject.played(), *subject.searches.explored()]
    lengths = {trace.steps for trace in idle}
    returns = {trace.total for trace in played if trace.ended and trace.rollout.seed == subject.episode_seed(0)}
    return len(lengths) == 1 and max(trace.steps for trace in played) <= max(lengths) and len(returns) > 1


def _is_time_limit(subject: Subject, idle: list[Trace]) -> bool:
    """Whether all episodes end at a step that the code calls a limit, which the check termination reports."""
    program = program_of(subject)
    named = terminates_at(program) if program is not None else None
    return named is not None and all(trace.steps == named[0] for trace in idle)


def _lost(trace: Trace) -> bool:
    return bool(trace.terminated) and trace.terminated[-1] and not trace.success


@hookimpl
def envcraft_checks() -> list[Check]:
    return [InstaDeath()]
