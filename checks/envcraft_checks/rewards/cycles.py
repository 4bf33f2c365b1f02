"""Whether a repeated loop of actions leads back to the same state of the game, in which only time has passed."""

from __future__ import annotations

import ast
import re
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from envcraft.judging.subject import Subject
    from envcraft.model.trace import StateChange, Trace

#: How often the loop is played, and the first of these times after which states are compared: motion settles down.
TIMES, _SETTLED = 12, 4
#: The share of the pixels that a clock takes, and the share of a number by which settling motion may still change it.
_CLOCK, _STILL = 0.1, 0.01
#: Names of what counts time in units of its own.
_TIME = re.compile(r"(^|_)t$|time|clock|tick|step|frame|elapsed|hour|minute|second", re.I)
#: What the worker says of an array that is too large to show, if it is a picture.
_PICTURE = re.compile(r"an array of uint8 \(\d+, \d+, 3\)")


def leads_back(subject: Subject, number: int, actions: list[Any], size: int) -> Trace | None:
    """Repeat a loop, and find out whether its repetitions begin in the same state.

    Numbers that count steps may differ, and pixels that change only once, as those of a bar do. So a loop that collects
    something, draws random numbers or meets something new does not lead back.

    Args:
        subject: the environment.
        number: of the seed.
        actions: those that end with the loop.
        size: how many actions the loop has.

    Returns:
        The episode, which ends with :data:`TIMES` repetitions; None if they begin in different states.
    """
    first = len(actions) - size
    ends = [first + size * repetition for repetition in range(_SETTLED, TIMES + 1)]
    if not subject.searches.spares(ends[-1]):
        return None
    rollout = subject.searches.script(number, actions[:first] + actions[first:] * TIMES, "a loop of actions")
    trace = subject.rollout(msgspec.structs.replace(rollout, keep=ends[-1] + 1, fields=True))
    complete = trace.usable and not trace.ended and trace.steps == ends[-1]
    if not complete or not len(trace.frames) == len(trace.states) == ends[-1] + 1:
        return None
    # What moves by itself needs longer than one held action to look the same again.
    looks = size == 1 or _look_alike([trace.frames[end] for end in ends])
    alike = looks and _are_alike(_states(trace.states, ends), size)
    return trace if alike else None


def _look_alike(frames: list[NDArray[Any]]) -> bool:
    """Whether pictures differ in few pixels, each of which changes once."""
    # Slow to import, and commands that list the rules must start fast.
    import numpy as np

    if len({frame.shape for frame in frames}) > 1:
        return False
    changes = sum((one != other).astype(np.uint8) for one, other in pairwise(frames))
    return bool(np.max(changes) <= 1 and np.mean(changes) <= _CLOCK)


def _states(changes: list[StateChange], ends: list[int]) -> list[dict[str, tuple[str, str]]]:
    """The fields after some of the calls."""
    fields: dict[str, tuple[str, str]] = {}
    states = []
    for number, change in enumerate(changes):
        fields |= change.changed
        for path in change.gone:
            fields.pop(path, None)
        if number in ends:
            states.append(dict(fields))
    return states


def _are_alike(states: list[dict[str, tuple[str, str]]], size: int) -> bool:
    """Whether all states have the same fields, but for those that count time."""
    if len({frozenset(state) for state in states}) > 1:
        return False
    changed = {path for one, other in pairwise(states) for path in one if one[path] != other[path]}
    return all(_is_time(path, [state[path][1] for state in states], size) for path in changed)


def _is_time(path: str, texts: list[str], size: int) -> bool:
    """Whether a field counts steps, holds a picture, or settles down."""
    if all(_PICTURE.fullmatch(text) for text in texts):
        return True
    import numpy as np

    try:
        values = np.array([ast.literal_eval(text) for text in texts], dtype=float)
    except (ValueError, SyntaxError, TypeError):
        return False
    steps = np.diff(values, axis=0)
    if values.ndim == 1 and np.allclose(steps, steps[0]) and (abs(steps[0]) == size or _TIME.search(path)):
        return True
    sizes = np.abs(steps)
    settling = sizes[-1] <= np.maximum(sizes[0] / 2, 1e-9)
    return bool(np.all(settling & (sizes[-1] <= _STILL * np.maximum(np.abs(values[-1]), 1))))
