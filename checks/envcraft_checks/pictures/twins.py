"""Left and right that always do the same."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from envcraft.model.rollout import Rollout

from .traces import Defect, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The moves of a pad, and those to the left and right. Up and down may do the same on purpose, such as a jump.
_MOVES, _LEFT, _RIGHT = 5, 3, 4
#: The most steps of an episode in which two moves are exchanged, and the episodes: the fewest and the most.
_STEPS, _EPISODES = 150, (2, 6)
#: The steps after which a move that undoes itself must have done so.
_BACK = 8


def find_twins(subject: Subject) -> Defect | None:
    """Find out whether left and right do the same in all play, and something else than doing nothing."""
    noop = subject.contract.noop
    if not (isinstance(noop, list) and len(noop) > 1 and shows_pictures(subject.observation_space)):
        return None
    held = {str(trace.rollout.actions[0]): trace for trace in subject.held() if trace.usable and not trace.opaque}
    moves = [held.get(str([move, *noop[1:]])) for move in range(_MOVES)]
    known = [trace for trace in moves if trace is not None]
    # Where each of the four does the same, the game takes any key.
    if len(known) < _MOVES or all(_alike(known[1], trace) for trace in known[2:]):
        return None
    if not _alike(known[_LEFT], known[_RIGHT]) or _alike(known[_LEFT], known[0]):
        return None
    if _undoes_itself(subject, known[_LEFT], known[0]) or not (compared := _exchanged(subject)):
        return None
    steps = sum(trace.steps for trace in compared)
    return Defect(
        f"the moves {_LEFT} and {_RIGHT}, left and right, do the same: {len(compared)} episodes of {steps} steps show "
        "and pay the same with each of these moves replaced by the other, and doing nothing shows something else",
        known[_LEFT].rollout.cut(known[_LEFT].steps),
        {"moves": [_LEFT, _RIGHT], "episodes": len(compared), "steps": steps},
    )


def _alike(one: Trace, two: Trace) -> bool:
    """Whether two episodes show and pay the same and end alike, as far as both are played."""
    steps = min(one.steps, two.steps)
    return all(
        first[:steps] == second[:steps]
        for first, second in (
            (one.observations[1:], two.observations[1:]),
            (one.rewards, two.rewards),
            (one.terminated, two.terminated),
            (one.truncated, two.truncated),
        )
    )


def _exchanged(subject: Subject) -> list[Trace]:
    """Episodes of varied play with left and right exchanged, each like the original.

    There are none if one differs, or if few are known. Both moves must occur often in each episode.
    """
    swap = {_LEFT: _RIGHT, _RIGHT: _LEFT}
    compared: list[Trace] = []
    for trace in [subject.episodes.whole[0], *subject.episodes.varied]:
        actions = trace.actions[: min(trace.steps, _STEPS)]
        if not trace.usable or not swap.keys() <= {action[0] for action in actions}:
            continue
        if len(compared) == _EPISODES[1] or not subject.affords(len(actions)):
            break
        exchanged: list[Any] = [[swap.get(move, move), *buttons] for move, *buttons in actions]
        other = subject.rollout(Rollout(trace.rollout.seed, exchanged, player="left and right exchanged"))
        if not other.usable or other.opaque or other.steps < len(actions) or not _alike(trace, other):
            return []
        compared.append(other)
    return compared if len(compared) >= _EPISODES[0] else []


def _undoes_itself(subject: Subject, held: Trace, idle: Trace) -> bool:
    """Whether a move twice is like doing nothing, as that of a player who changes between two lanes: then the opposite
    move must do the same.
    """
    move, nothing = held.rollout.actions[0], idle.rollout.actions[0]
    actions = [move, move, *[nothing] * _BACK]
    trace = subject.rollout(Rollout(held.rollout.seed, actions, player=f"{move} twice"))
    last = min(trace.steps, idle.steps)
    return trace.observations[last] == idle.observations[last]
