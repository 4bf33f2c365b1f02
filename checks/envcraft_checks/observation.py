"""# observation

## What it does
Checks that the observation carries information. It must change in some episode, unless the contract prescribes no
picture and the environment is a contextual bandit: seeds have different observations, rewards vary, and actions do not
end an episode. If an action does not always earn the same on a seed, this is a warning: the observation may hide what
changes. It must not be independent noise. The same seed under different actions must lead to different
observations. `render()` must return the observation if the contract requires it, or if it is optional and the class
defines it. A picture may change rarely, or only when the agent acts.

A picture is frozen if it changes for the last time at the same step in episodes of several seeds and policies, and at
least half of each of these episodes follows that step. No other play may change it later: held actions, all actions in
rotation, or exploration. A game that gets stuck does so at different steps, and some policy plays the action that a
waiting game needs. A picture is also frozen if it stops changing after some step or reward of at least three episodes
while the game continues. The game continues if the same action at the same picture earns different rewards, or if a
search reaches different states that look the same. A game that is over or stuck does neither. Last, a picture is frozen
if a search finds a state after which it does not change in four episodes, at least 60 steps in all, although moves lead
to different states. These steps are enough for a light that is off for a while to come back.

If step() fails whenever some action is taken, nothing is known of the observations after it. Then the check does not
decide whether the observation is constant, unresponsive or without the agent.

From the budget `standard` on and under a contract with a limit, actions must not lose their effect. In the first random
episode, other actions are played for the last 150 of at most 600 steps. If they lead to the same pictures and rewards,
the same is done in an episode that acts at one step in 32, in which fuel lasts. It is an error if they do so in both.

The contrast is too low if no channel of any picture spans more than eight of 255 levels. A dark game usually has a
bright pixel in some picture. Small pictures may contain codes instead of colours, and so may grey pictures that no
contract prescribes.

An agent is invisible if two things hold. In episodes that each hold one move, no picture differs before the rewards and
flags do. The moves also lead to at least three different, lasting states of the game, or to different results of
episodes that do nothing after the first moves. Three or more results are an error, and two are a warning. A move may
become visible late, or matter only while its button is pressed.

From the budget `standard` on, an agent has left the picture if, after one move that is held for 60 steps, all moves
have the same pictures as doing nothing, and lead to at least three different states.

A picture is late (a warning) if in each of at least three states all moves lead to the same next picture, and to
different ones a step later, although rewards or ends differ at once. Then an agent sees what an action does one step
after it is paid for it. A player with momentum may be seen late, too, but is also paid late.

State is hidden (a warning) if three quarters of all rewards and terminations follow a picture and an action that also
had another result, and the picture does not make the event more likely. The cause of a loss is hidden, too, if the last
action of the episode does not lose a few steps later, although no picture changes in between. The game must not draw
random numbers during play. Memory games hide state on purpose.

Left and right should differ. They are alike (a warning) if three things hold: holding either gives the same pictures
and rewards, doing nothing gives others, and varied episodes stay the same when one move replaces the other. All four
moves may be alike, and a move that undoes itself may equal its opposite.

Noise is measured on the pixels that vary: each one minus its mean over time, correlated with itself one to four steps
later while one action is held. The picture is noise if more than half of it changes at each step, no lag correlates,
and no picture is a shifted copy of the one before.

## Why is this bad?
An agent sees only the observation. If it does not show the game, the agent can learn nothing from it, however good the
game is.

## Example
```python
def _draw(self):
    frame = self.background.copy()
    frame[self.start_y, self.start_x] = WHITE   # EC403: draws where the player was, not where it is
```
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from envcraft.errors import Skip, Undecided
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.verdict import Finding, Severity
from envcraft.plugins import hookimpl
from envcraft.text import plural

from .pictures.contrast import find_faint
from .pictures.drawing import frame_line
from .pictures.frozen import find_frozen
from .pictures.hidden import find_hidden, find_unseen
from .pictures.invisible import find_invisible, find_strayed
from .pictures.late import find_late
from .pictures.noise import find_noise
from .pictures.traces import Defect, only_raising
from .pictures.twins import find_twins
from .pictures.unresponsive import find_dead, find_unresponsive

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.spaces.spec import SpaceSpec


#: Codes of observations that show too little under all actions together: the action that is left out may show it.
_NEEDS_EACH_ACTION = frozenset({"EC401", "EC403", "EC407"})


class Observation(Check):
    name = "observation"
    rules = (
        Rule(
            "EC401",
            "constant",
            "The observation never changes, or stops changing at some step.",
            "Draw the frame after the change of state.",
        ),
        Rule(
            "EC402", "noise", "The observation is independent noise.", "Draw the state of the game, not random pixels."
        ),
        Rule("EC403", "unresponsive", "The observation does not react to actions.", "Draw what the agent controls."),
        Rule(
            "EC404",
            "unlike-render",
            "The observation differs from render().",
            "Draw both with one method, after all changes of state.",
            confirmed_by=("EC208",),
        ),
        Rule(
            "EC405",
            "low-contrast",
            "The picture uses only a few brightness levels.",
            "Scale colours to 0 to 255 before they are cast to uint8.",
        ),
        Rule(
            "EC406",
            "hidden-state",
            "The same action at the same picture earns different rewards.",
            "Draw what determines the reward, such as a timer or a direction.",
            Severity.WARNING,
        ),
        Rule(
            "EC407",
            "agent-invisible",
            "Moves matter, but no picture shows them.",
            "Draw what the agent controls where it is.",
        ),
        Rule(
            "EC408",
            "moves-alike",
            "Left and right always do the same.",
            "Give each direction of the pad its own effect, or none.",
            Severity.WARNING,
        ),
        Rule(
            "EC409",
            "picture-late",
            "Each picture shows the game as it was before the action.",
            "Draw the frame at the end of step(), after all changes of state.",
            Severity.WARNING,
        ),
        Rule(
            "EC410",
            "actions-without-effect",
            "From some step on, no action has an effect.",
            "Count down what stops the player, such as a stun, at every step, or end the episode.",
        ),
    )

    def judge(self, subject: Subject) -> Iterator[Finding]:
        traces = [trace for trace in subject.played() if len(trace.observations) > 1]
        if not traces:
            raise Undecided("no episode has a second observation")
        longest = max(traces, key=lambda trace: trace.steps)
        if _only_value(subject.observation_space):
            raise Skip("the observation space has only one value")
        if subject.contract.observation is None and longest.steps == 1:
            raise Skip("every episode is one step long, and no agent acts on its last observation")
        seen = [trace for trace in traces if not trace.opaque]
        if len(seen) == len(traces) and all(len(set(trace.observations)) == 1 for trace in traces):
            bandit = subject.contract.observation is None and _may_be_bandit(traces)
            if bandit and _always_pays_alike(traces):
                return
            found = self.finding(
                "EC401",
                f"the observation does not change in any of {len(traces)} episodes, "
                f"{sum(trace.steps for trace in traces)} steps in total"
                f"{', which is right only for a contextual bandit' if bandit else ''}",
                line=subject.line_of("step"),
                repro=repro(longest.rollout.cut(20)),
            )
            first: Finding | None = found.as_warning() if bandit else found
        else:
            first = self._first(subject, seen)
        compared = first is not None and first.code in _NEEDS_EACH_ACTION
        raising = only_raising(subject.played()) if compared else []
        if first is not None and not raising:
            yield first
        yield from self._find_unlike_render(subject)
        if raising:
            raise Undecided(f"step() fails at {_in_words(raising)}, so no observation after it could be compared")
        if len(seen) < len(traces):
            raise Skip("some observations cannot be compared: they have types of another package, or are too large")

    def _first(self, subject: Subject, traces: list[Trace]) -> Finding | None:
        """The first defect only: a picture that shows nothing has all those that follow."""
        for code, defect in _defects(subject, traces):
            if defect is not None:
                finding = self.finding(
                    code,
                    defect.message,
                    line=(frame_line(subject) if code == "EC409" else None) or subject.line_of("step"),
                    repro=repro(defect.rollout),
                    **defect.evidence,
                )
                return finding if defect.certain else finding.as_warning()
        return None

    def _find_unlike_render(self, subject: Subject) -> Iterator[Finding]:
        if not (subject.contract.render and subject.renders):
            return
        for trace in filter(None, (subject.rendered(), subject.rendered_best())):
            # The check api reports an observation of the wrong type.
            bad = {problem.step for problem in trace.problems}
            differing = (problem.step for problem in trace.render_problems if problem.kind == "differs")
            step = next((step for step in differing if step not in bad), None)
            if step is not None:
                at = f"step {step}" if step else "the reset"
                yield self.finding(
                    "EC404",
                    f"after {at} render() returns another picture than the observation",
                    line=(frame_line(subject) if step else None) or subject.line_of("render"),
                    repro=repro(trace.rollout.cut(step)),
                    step=step,
                )
                return


def _defects(subject: Subject, traces: list[Trace]) -> Iterator[tuple[str, Defect | None]]:
    """Run each finder, after the one whose defect would cause its own."""
    yield "EC405", find_faint(subject)
    yield "EC402", find_noise(subject)
    yield "EC403", find_unresponsive(subject, traces)
    yield "EC407", find_invisible(subject)
    yield "EC401", find_frozen(subject, traces)
    yield "EC409", find_late(subject)
    yield "EC408", find_twins(subject)
    # Other rules need what is left of the budget, unless all episodes end early.
    ended = all(trace.ended for trace in subject.episodes.whole)
    if ended and subject.searches.spares(subject.budget.steps // 4):
        if subject.budget.sweep:
            yield "EC407", find_strayed(subject)
        yield "EC410", find_dead(subject)
    yield "EC406", find_hidden(subject, traces) or find_unseen(subject, traces)


def _in_words(actions: list[str]) -> str:
    more = len(actions) - 1
    return f"the action {actions[0]}" + (f" and {plural(more, 'other')}" if more else "")


def _may_be_bandit(traces: list[Trace]) -> bool:
    """Whether play may be that of a contextual bandit, whose context stays for an episode: the observation differs
    between seeds, steps of one episode pay differently, and no action ends an episode sooner.
    """
    contexts = {trace.observations[0] for trace in traces}
    ends = {trace.steps for trace in traces if trace.ended}
    longest = max(trace.steps for trace in traces)
    paid = {(trace.rollout.seed, reward) for trace in traces for reward in trace.rewards}
    return len(contexts) > 1 and ends <= {longest} and len(paid) > len({seed for seed, _ in paid})


def _always_pays_alike(traces: list[Trace]) -> bool:
    """Whether on each seed an action always earns the same, so that nothing is hidden."""
    earned: dict[tuple[int, str], float] = {}
    return all(
        earned.setdefault((trace.rollout.seed, repr(action)), reward) == reward
        for trace in traces
        for action, reward in zip(trace.actions, trace.rewards, strict=False)
    )


def _only_value(space: SpaceSpec) -> bool:
    from envcraft.spaces.spec import Box, Discrete

    if isinstance(space, Box):
        return space.bounded and space.low == space.high
    return isinstance(space, Discrete) and space.n == 1


@hookimpl
def envcraft_checks() -> list[Check]:
    return [Observation()]
