"""Pictures that show the game as it was before the action: each observation is one step late."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

from envcraft.model.rollout import Rollout

from .invisible import simple_moves
from .traces import Defect, shows_pictures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The fewest actions that are compared in one state, and the steps of random play after which others are.
_COMPARED, _STATES = 4, (3, 8, 15)
#: The latest step of an event, the most events, and the share of all steps that a rare reward has at most.
_SOON, _EVENTS, _RARE = 80, 4, 0.05


def find_late(subject: Subject) -> Defect | None:
    """Find out whether no action shows in the next picture, but in the one after that, while it is paid at once.

    A player whose speed follows the action, and whose place follows the speed one step later, is seen late and paid
    late.
    """
    if not shows_pictures(subject.observation_space):
        return None
    held = [trace for trace in subject.held() if trace.usable and not trace.opaque]
    if not _is_late(held, 1):
        return None
    moves, states = simple_moves(subject), 1
    random = subject.episodes.whole[0]
    for step in _STATES:
        if not subject.affords(len(moves) * (step + 2)):
            return None
        tried = _others(subject, random, step, moves)
        if any(len({each.observations[at] for each in tried}) > 1 for at in range(step + 2) if tried):
            return None
        states += _is_late(tried, step + 1)
    if states < len(_STATES):
        return None
    for trace, step in _events(subject):
        if not subject.affords(len(moves) * step):
            break
        for other in _others(subject, trace, step - 1, moves):
            if _result(other, step) != _result(trace, step) and other.observations[step] == trace.observations[step]:
                return Defect(
                    f"pictures are one step late: in {states} states no action changes the next picture, and some "
                    f"change the one after that; at step {step} {trace.rollout.player} gets {_words(trace, step)} and "
                    f"{other.actions[step - 1]} gets {_words(other, step)}, and both show the same picture",
                    trace.rollout.cut(step),
                    {"states": states, "step": step, "other": other.actions[step - 1]},
                )
    return None


def _is_late(traces: list[Trace], step: int) -> bool:
    """Whether traces that differ from a step on show the same picture after it and different ones a step later."""
    lasting = [trace for trace in traces if trace.steps > step]
    if len(lasting) < _COMPARED or len({trace.observations[step] for trace in traces if trace.steps >= step}) > 1:
        return False
    return len({trace.observations[step + 1] for trace in lasting}) > 1


def _others(subject: Subject, trace: Trace, step: int, moves: list[Any]) -> list[Trace]:
    """Episodes that make other moves after the first steps of one, and then do nothing for a step."""
    if trace.steps <= step:
        return []
    path, player = trace.actions[:step], f"other moves after step {step}"
    rollouts = [Rollout(trace.rollout.seed, [*path, move, moves[0]], player=player) for move in moves]
    return [each for each in subject.rollouts(rollouts) if each.usable and not each.opaque and each.steps > step]


def _events(subject: Subject) -> Iterator[tuple[Trace, int]]:
    """The soonest steps that terminate an episode or pay what few steps pay, one of each trace."""
    traces = [trace for trace in subject.played() if trace.usable and not trace.opaque]
    counts = Counter(reward for trace in traces for reward in trace.rewards)
    most = _RARE * counts.total()
    found: list[tuple[int, int, Trace]] = []
    for number, trace in enumerate(traces):
        steps = range(1, min(trace.steps, _SOON) + 1)
        rare = (step for step in steps if trace.terminated[step - 1] or counts[trace.rewards[step - 1]] <= most)
        found += [(step, number, trace) for step in [next(rare, 0)] if step > 1]
    for step, _, trace in sorted(found, key=lambda each: each[:2])[:_EVENTS]:
        yield trace, step


def _result(trace: Trace, step: int) -> tuple[float, bool]:
    return trace.rewards[step - 1], trace.terminated[step - 1]


def _words(trace: Trace, step: int) -> str:
    reward, terminated = _result(trace, step)
    return f"{reward:g}{' and ends' if terminated else ''}"
