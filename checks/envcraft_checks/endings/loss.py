"""Losses that do not end the episode, or end it as truncated."""

from __future__ import annotations

import ast
from collections import Counter
from typing import TYPE_CHECKING

from envcraft.judging.shrink import repro
from envcraft.model.rollout import Rollout
from envcraft_checks.linting.evading import starts_again
from envcraft_checks.linting.program import line, program_of

from .flags import returned_flags

if TYPE_CHECKING:
    from collections.abc import Iterator

    from envcraft.judging.check import Check
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.model.verdict import Finding

#: The fewest steps after a loss in which actions must change nothing, and the fewest actions that must be played there;
#: also the fewest lengths of episodes that a time limit does not explain.
_DEAD, _VARIED = 150, 3
#: The share of the longest episode within which one ends soon.
_SOON = 0.5
#: The values that step() returns.
_RESULTS = 5


def find_ongoing(check: Check, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
    """Find an episode that goes on after the step that costs most, though no action changes anything any more."""
    dead = [(trace, step) for trace in traces if (step := _over(trace))]
    for trace, step in sorted(dead, key=lambda each: each[1]):
        last = min(limit, trace.steps)
        if last < limit or any(_survives(other, trace.rewards[step - 1]) for other in traces):
            continue
        if _changes_nothing(subject, trace, step, last):
            yield check.finding(
                "EC509",
                f"step {step} costs most, with a reward of {trace.rewards[step - 1]:g}, but the episode goes on for "
                f"{last - step} more steps in which actions change neither the observation nor the reward",
                line=subject.line_of("step"),
                repro=repro(trace.rollout.cut(last)),
                step=step,
                steps=last - step,
            )
            return


def find_truncated(check: Check, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
    """Find losses whose only flag is truncated: they come at steps that depend on play, and no loss terminates."""
    known = [*traces, *(trace for trace in subject.searches.explored() if trace.usable and trace.steps)]
    if any(trace.ended and trace.terminated[-1] and not trace.success for trace in known):
        return
    longest = max(known, key=lambda trace: trace.steps)
    cut = [trace for trace in known if trace.ended and not trace.terminated[-1] and not trace.reported_success]
    cut = [trace for trace in cut if trace.steps <= longest.steps * _SOON]
    kinds = [{trace.steps for trace in cut}, {_since_paid(trace) for trace in cut}]
    if min(map(len, kinds)) < _VARIED:
        return
    program = program_of(subject)
    # A clock that starts again is a time limit.
    if program is not None and starts_again(program):
        return
    # Each level may have a limit of its own.
    if len({trace.rollout.seed for trace in cut}) == len({(trace.rollout.seed, trace.steps) for trace in cut}):
        return
    costly = all(trace.rewards[-1] < min(0.0, *trace.rewards[:-1]) for trace in cut)
    shortest = min(cut, key=lambda trace: trace.steps)
    place, misplaced = returned_flags(subject)
    finding = check.finding(
        "EC510",
        f"{len(cut)} episodes are truncated, and none is terminated without success, but this is not a time limit: "
        f"they end after {shortest.steps} to {max(trace.steps for trace in cut)} steps, depending on the actions, "
        f"{'and their last steps cost most, ' if costly else ''}while {longest.rollout.player} goes on "
        f"to step {longest.steps}{misplaced}",
        line=place if misplaced else _truncating_line(subject) or place,
        repro=repro(shortest.rollout.cut(shortest.steps)),
        episodes=len(cut),
        shortest=shortest.steps,
        longest=longest.steps,
    )
    yield finding if costly else finding.as_warning()


def _over(trace: Trace) -> int:
    """The last step that pays another reward than all that follow, if it costs most of all and many follow; else 0."""
    if trace.opaque or trace.reported_success or trace.terminated[-1]:
        return 0
    last = next((step for step in range(trace.steps, 0, -1) if trace.rewards[step - 1] != trace.rewards[-1]), 0)
    costs = last > 0 and trace.rewards[last - 1] == min(trace.rewards) and trace.rewards[last - 1] < 0
    return last if costs and trace.steps - last >= _DEAD else 0


def _survives(trace: Trace, reward: float) -> bool:
    """Whether an episode shows something new after a step that costs as much."""
    if not trace.usable or trace.opaque:
        return False
    first = next((step for step, paid in enumerate(trace.rewards, 1) if paid <= reward), trace.steps)
    later = trace.rewards[first + 1 :]
    return len(set(later)) > 1


def _changes_nothing(subject: Subject, trace: Trace, step: int, last: int) -> bool:
    """Whether varied actions leave the observation as it is between two steps, or other actions lead to the same."""
    varied = len({str(action) for action in trace.actions[step:last]}) > _VARIED
    if varied and len(set(trace.observations[step : last + 1])) <= 1:
        return True
    # The end may be an animation, which other actions leave as it is.
    return subject.affords(last) and _alike(trace, subject.rollout(_otherwise(subject, trace, step, last)), step, last)


def _otherwise(subject: Subject, trace: Trace, step: int, last: int) -> Rollout:
    """The same episode up to one step after `step`, and then other actions."""
    from envcraft.judging.actions import sticky_actions

    seed = trace.rollout.seed
    others = sticky_actions(subject.action_space, seed + 1, last - step - 1)
    return Rollout(seed, trace.actions[: step + 1] + others, player=f"other actions after step {step + 1}")


def _alike(one: Trace, two: Trace, first: int, last: int) -> bool:
    """Whether two episodes show and pay the same between two steps."""
    if not two.usable or two.opaque or two.steps < last or two.terminated[last - 1]:
        return False
    return (
        one.observations[first : last + 1] == two.observations[first : last + 1]
        and one.rewards[first:last] == two.rewards[first:last]
    )


def _since_paid(trace: Trace) -> int:
    """The steps from the last unusual reward to the last step, whose own reward may be that of the end."""
    usual, _ = Counter(trace.rewards).most_common(1)[0]
    rewards = trace.rewards[-2::-1]
    return next((steps for steps, reward in enumerate(rewards, 1) if reward != usual), trace.steps)


def _truncating_line(subject: Subject) -> int | None:
    """The one line of step() that decides `truncated`; None where several may."""
    program = program_of(subject)
    step = program.method(program.env, "step") if program is not None else None
    if step is None:
        return None
    returned = [node.value for node in step.nodes if isinstance(node, ast.Return)]
    flags = [value.elts[-2] for value in returned if isinstance(value, ast.Tuple) and len(value.elts) == _RESULTS]
    names = {node.id for flag in flags for node in ast.walk(flag) if isinstance(node, ast.Name)}
    named = {name for name in names if "trunc" in name} or names
    lines = {
        line(statement)
        for target, value, statement in step.bindings
        if isinstance(target, ast.Name) and target.id in named and not isinstance(value, ast.Constant)
    }
    return lines.pop() if len(lines) == 1 else None
