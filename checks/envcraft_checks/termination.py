"""# termination

## What it does
Plays random, held, idle and mixed episodes to the contract's limit, and goes on after a success, a large reward or a
loss. With `--policy FILE` it also plays the actions of the privileged policy. Each episode must end by itself by then.
The end at the limit must be `truncated`, not `terminated`. Flags must be booleans of Python or NumPy. A game whose
episodes all last at most five steps is allowed if its actions make a difference. Gymnasium leaves open what `step` does
after an episode's end, so flags that become false again are only a warning. It is an error if the reward of the end
comes a step late, because no agent receives it. The first step after the end, and no other one, then pays more than any
step of an episode, or it pays the same in five episodes whose last steps pay something else.

It also finds the step counter in the code. If nothing else limits an episode, play must not reset the counter, skip it
for some actions, or increase it past a number that it must equal. If the counter must start again more than once to
outlast the limit, a search looks for play that does it. Under a contract without a limit, an action that stops all
change is held for twice as many steps as the code allows.

A success must end the episode as `terminated`. If only `truncated` is set, the check looks for a longer episode on the
same seed, which shows that the end is not a time limit.

Under a contract with a limit, the same holds for a loss. It is reported if no episode is terminated without success,
and many are truncated at different steps of one seed, in the first half of the longest episode. It is an error if the
last step of each of them costs more than every step before it, else a warning: Gymnasium also truncates what leaves the
bounds of its model.
A clock that starts again at each reward, such as hunger, is a time limit.

If info reports no success, an end at the limit that pays more than any step before it is a goal, such as survival, and
may be terminated. A game may have a rule that ends it at a fixed step before the contract's limit, such as a torch that
burns out. The check reports a time limit with swapped flags if all episodes that reach this step are terminated and all
shorter ones are truncated. It also does so if the code names the limit, such as `max_steps`, and truncates nothing.

Under a contract with a limit, success ends the episode. It is a defect if only time passes after the success: for at
least 30 steps of any play, no reward is paid, or doing nothing earns a reward at each step. A temporary success, such
as on a plate that opens a door, is fine.

A loss ends the episode, too. It is an error if an episode goes on after the step that costs most, and its rewards do
not change any more. For at least 150 steps, up to the limit if the budget allows, other actions must lead to the same
pictures and rewards. A player who is only stunned, or who appears again, acts sooner than that.

## Why is this bad?
An episode that never ends fills a replay memory with one situation and hangs evaluations. A time limit that is reported
as termination teaches the agent that no further reward can follow.

## Example
```python
terminated = self.lives == 0 or self.steps >= 1000   # EC502
truncated = False
```
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro, shrunk
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .endings import after, loss, success, time_limit
from .endings.flags import flag_line
from .interface.lines import lines_of_call
from .linting.program import program_of

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

_FLAGS = ("bool", "numpy.bool")
#: The most steps of an episode that is too short to play.
_PLAYABLE = 5


class Termination(Check):
    name = "termination"
    rules = (
        Rule("EC501", "never-ends", "An episode does not end by the limit.", "Set truncated at the step limit."),
        Rule(
            "EC502",
            "limit-as-termination",
            "The time limit is reported as termination.",
            "Set truncated at the limit, and terminated only when the game itself ends.",
        ),
        Rule(
            "EC503",
            "ends-at-once",
            "Every episode ends before play is possible.",
            "Check the condition that ends an episode, and the state that reset() sets.",
        ),
        Rule("EC504", "flag-type", "terminated or truncated is not a boolean.", "Return `bool(...)`."),
        Rule(
            "EC505",
            "goes-on",
            "The episode continues after its end.",
            "Keep both flags unchanged until reset().",
            Severity.WARNING,
        ),
        Rule(
            "EC506",
            "success-does-not-end",
            "The episode goes on after its success.",
            "Set terminated at the step whose info reports success.",
        ),
        Rule(
            "EC507",
            "success-as-truncation",
            "A success ends the episode as truncated.",
            "Set terminated when the game is won, and truncated only at the step limit.",
        ),
        Rule(
            "EC508",
            "paid-after-end",
            "The largest reward is paid at the step after the end.",
            "Pay for the end in the step that sets terminated.",
        ),
        Rule(
            "EC509",
            "loss-does-not-end",
            "The episode goes on after it is lost.",
            "Set terminated at the step that loses the game.",
        ),
        Rule(
            "EC510",
            "loss-as-truncation",
            "A loss ends the episode as truncated.",
            "Set terminated when the game is lost, and truncated only at the step limit.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [*subject.played(), *subject.episodes.rotations[:4], *subject.searches.onward, *subject.privileged()]
        usable = [trace for trace in traces if trace.usable and trace.steps]
        if not usable:
            raise Undecided("each episode raises an error or has no step")
        flags = ((trace, finding) for trace in usable for finding in self._judge_flags(subject, trace))
        for trace, finding in itertools.islice(flags, 1):
            small = shrunk(subject, trace.rollout, finding, lambda played: self._judge_flags(subject, played))
            yield _placed(subject, small)
        limit = subject.contract.limit
        if limit is not None:
            wrong = list(time_limit.find_wrong(self, subject, usable, limit))
            found = wrong or list(success.find_truncated(self, subject, usable))
            yield from found or loss.find_truncated(self, subject, usable)
            if not any(finding.code == "EC501" for finding in wrong):
                yield from time_limit.find_evaded(self, subject, limit)
            yield from success.find_ongoing(self, subject)
            yield from loss.find_ongoing(self, subject, usable, limit)
        else:
            yield from success.find_truncated(self, subject, usable)
            yield from time_limit.find_paused(self, subject)
        yield from self._judge_short(subject, usable)
        yield from after.find_events(self, subject, usable)

    def _judge_flags(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        for step, kinds in enumerate(trace.flag_types, 1):
            for name, kind in zip(("terminated", "truncated"), kinds, strict=True):
                if kind not in _FLAGS:
                    program = program_of(subject)
                    yield self.finding(
                        "EC504",
                        f"{name} is {kind} at step {step}, not a bool (under {trace.rollout.player})",
                        line=(program and flag_line(program, name)) or subject.line_of("step"),
                        repro=repro(trace.rollout.cut(step)),
                        step=step,
                        flag=name,
                    )

    def _judge_short(self, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
        ended = [trace for trace in traces if trace.ended]
        if len(ended) < 6 or max(trace.steps for trace in traces) > _PLAYABLE:
            return
        # Not the rest of info: it may tell where the player is, who can do nothing there.
        outcomes: dict[int, set[tuple[float, int, bool | None]]] = {}
        for trace in ended:
            outcome = trace.total, trace.steps, trace.reported_success
            outcomes.setdefault(trace.rollout.seed, set()).add(outcome)
        decided = any(len(different) > 1 for different in outcomes.values())
        # A truncation this far from the contract's limit is a defect of any game.
        cut = subject.contract.limit is not None and any(trace.truncated[-1] for trace in ended)
        if decided and not cut:
            return
        longest = max(ended, key=lambda trace: trace.steps)
        why = "and a truncation ends some of them" if cut else "and no action changes the return or the end"
        yield self.finding(
            "EC503",
            f"all {len(ended)} episodes end within {plural(longest.steps, 'step')} under every policy, {why}",
            line=subject.line_of("step"),
            repro=repro(longest.rollout.cut(longest.steps)),
            episodes=len(ended),
        )


def _placed(subject: Subject, finding: Finding) -> Finding:
    """A finding about a flag with the line that gave it its value, where several do."""
    program = program_of(subject)
    if program is None or finding.line != subject.line_of("step").number:
        return finding
    ran = lines_of_call(subject, finding, finding.evidence["step"])
    line = flag_line(program, finding.evidence["flag"], ran)
    return finding if line is None else msgspec.structs.replace(finding, line=line)


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Termination()]
