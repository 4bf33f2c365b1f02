"""Agents that no picture shows: moves that matter and are seen too late, or not at all."""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

from envcraft.model.rollout import Rollout

from .traces import Defect, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: Steps of a move that is held, steps of the episode, and the most moves.
_MOVED, _WAITED, _MOVES = 8, 120, 6
#: Steps of a move that leads far away.
_FAR = 60
#: The fewest episodes that are compared, and the fewest states that moves lead to.
_COMPARED, _LASTING = 3, 3


def find_invisible(subject: Subject) -> Defect | None:
    """Find moves that no picture shows before they are paid."""
    if not shows_pictures(subject.observation_space):
        return None
    moves = simple_moves(subject)
    held = [trace for trace in subject.held() if trace.rollout.actions[0] in moves and not trace.opaque]
    if len(held) < _COMPARED or _first_apart(held) == "seen":
        return None
    states = subject.searches.hidden_states([], subject.episode_seed(0))
    if states >= _LASTING:
        longest = max(held, key=lambda trace: trace.steps)
        return Defect(
            f"moves lead to {states} states of the game with the same pictures; in {len(held)} episodes that hold one "
            f"move, no picture differs before the rewards and flags do, up to step {longest.steps}",
            longest.rollout.cut(longest.steps),
            {"states": states, "compared": len(held)},
        )
    return _find_paid_unseen(subject, moves) if _first_apart(held) == "paid" else None


def find_strayed(subject: Subject) -> Defect | None:
    """Find a move that leads out of the picture: no move after it is seen, though the states differ."""
    if not shows_pictures(subject.observation_space):
        return None
    for move in simple_moves(subject)[1:]:
        if not subject.searches.spares(2 * _FAR):
            return None
        path = [move] * _FAR
        states = subject.searches.unseen_states(path, subject.episode_seed(0))
        if states >= _LASTING:
            return Defect(
                f"after {_FAR} times {move} all moves have the same pictures as doing nothing, though they lead to "
                f"{states} states of the game: what they control has left the picture",
                Rollout(subject.episode_seed(0), path, player=f"holding {move}"),
                {"states": states, "steps": _FAR},
            )
    return None


def _find_paid_unseen(subject: Subject, moves: list[Any]) -> Defect | None:
    """Find moves that rewards or endings show later, and no picture before them."""
    length = min(_WAITED, subject.length)
    if not subject.affords(length * len(moves)):
        return None
    rest = [moves[0]] * (length - _MOVED)
    words = "doing nothing" if moves[0] == subject.contract.noop else f"holding {moves[0]}"
    rollouts = [
        Rollout(subject.episode_seed(0), [move] * _MOVED + rest, player=f"{_MOVED} times {move}, then {words}")
        for move in moves
    ]
    traces = [trace for trace in subject.rollouts(rollouts) if trace.usable and trace.steps > _MOVED]
    if _first_apart(traces) != "paid":
        return None
    # Episodes that are paid apart during the moves may be paid for the moves themselves.
    early: dict[tuple[Any, ...], list[Trace]] = defaultdict(list)
    for trace in traces:
        early[*trace.rewards[:_MOVED], *trace.observations[: _MOVED + 1]].append(trace)
    same = max(early.values(), key=len)
    outcomes = {_outcome(trace, _MOVED): trace for trace in same}
    if len(outcomes) < 2:
        return None
    shown = min(outcomes.values(), key=lambda trace: trace.steps)
    differing = " or ".join(str(trace.rollout.actions[0]) for trace in outcomes.values())
    return Defect(
        f"{_MOVED} times {differing}, then {words}: rewards and endings differ in {len(outcomes)} ways within "
        f"{length} steps, but no earlier picture differs",
        shown.rollout.cut(shown.steps),
        {"outcomes": len(outcomes), "compared": len(same)},
        certain=len(outcomes) > 2,
    )


def simple_moves(subject: Subject) -> list[Any]:
    """The actions that differ from the first one, or from doing nothing, in one component only, the same for all."""
    joint = subject.joint_actions
    if not isinstance(joint[0], list):
        return joint[:_MOVES]
    by_place: dict[int, list[Any]] = defaultdict(list)
    for action in joint[1:]:
        differing = [at for at, (one, other) in enumerate(zip(action, joint[0], strict=True)) if one != other]
        if len(differing) == 1:
            by_place[differing[0]].append(action)
    return [joint[0], *max(by_place.values(), key=len, default=[])][:_MOVES]


def _first_apart(traces: list[Trace]) -> str:
    """How the traces of one seed first differ.

    Returns:
        ``seen`` if pictures of two differ before their rewards and flags do, and not by an event that is paid alike;
        ``paid`` if no pictures do and rewards or flags of some differ; else nothing.
    """
    apart = ""
    usual = Counter(reward for trace in traces for reward in trace.rewards).most_common(1)
    for one, two in itertools.combinations(traces, 2):
        for step in range(min(one.steps, two.steps)):
            if one.observations[step] != two.observations[step]:
                return "seen"
            results = {_result(one, step), _result(two, step)}
            # Two events may be paid alike.
            alike = one.rewards[step] != usual[0][0] and one.observations[step + 1] != two.observations[step + 1]
            if len(results) > 1 or alike:
                apart = "paid"
                break
    return apart


def _result(trace: Trace, step: int) -> tuple[float, bool, bool]:
    return trace.rewards[step], trace.terminated[step], trace.truncated[step]


def _outcome(trace: Trace, start: int) -> tuple[Any, ...]:
    return trace.steps, *trace.rewards[start:]
