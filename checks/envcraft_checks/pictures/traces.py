"""What all finders share: the defect that they report, and how the observations of a trace change."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from envcraft.model.rollout import Rollout

if TYPE_CHECKING:
    from envcraft.model.trace import Trace
    from envcraft.spaces.spec import SpaceSpec


class Defect(NamedTuple):
    """What a finder reports of one environment.

    Attributes:
        message: one sentence for the user.
        rollout: shows the defect.
        evidence: further data for the report, as JSON values.
        certain: whether the severity is that of the rule; if not, the defect is a warning.
    """

    message: str
    rollout: Rollout
    evidence: dict[str, Any]
    certain: bool = True


def shows_pictures(space: SpaceSpec) -> bool:
    """Whether observations are pictures. A short vector may be random at each step, as in a bandit."""
    from envcraft.spaces.spec import Box

    return isinstance(space, Box) and len(space.shape) >= 2 and space.dtype == "uint8"


def only_raising(traces: list[Trace]) -> list[str]:
    """The actions, as text, with which every step failed."""
    failed = {repr(action): None for trace in traces for action in trace.actions[trace.steps :]}
    taken = {repr(action) for trace in traces for action in trace.actions[: trace.steps]}
    return [action for action in failed if action not in taken]


def changed(trace: Trace, step: int) -> bool:
    """Whether a step, counted from 1, changed the observation."""
    return trace.observations[step] != trace.observations[step - 1]
