"""Make a reproduction smaller while the defect still shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from envcraft.model.rollout import Rollout
from envcraft.model.verdict import Repro


def shrink(
    rollout: Rollout, step: int, shows: Callable[[Rollout], bool], noop: Any, tries: int = 16, steps: int = 1_000
) -> Rollout:
    """Cut the actions after a step, then replace parts of the others by doing nothing.

    The parts are halves, quarters, eighths … in turn, as in delta debugging (Zeller & Hildebrandt 2002,
    doi:10.1109/32.988498).

    Args:
        rollout: shows the defect.
        step: the step of the defect.
        shows: whether a rollout still shows the defect.
        noop: the action that does nothing; None if there is none.
        tries: the maximum number of rollouts with replaced actions.
        steps: the maximum number of their environment steps.

    Returns:
        The smallest rollout that shows the defect, which may be `rollout` itself.
    """
    best = rollout
    for length in dict.fromkeys((step, step + 1)):
        candidate = rollout.cut(length)
        if length < len(rollout.actions) and shows(candidate):
            best = candidate
            break
    if noop is None or rollout.policy:
        return best
    parts = 1
    while tries > 0 and parts <= max(len(best.actions), 1) and parts <= 16:
        size = -(-len(best.actions) // parts)
        for start in range(0, len(best.actions), max(size, 1)):
            idle = [noop if start <= at < start + size else action for at, action in enumerate(best.actions)]
            if idle == best.actions or tries <= 0 or steps < len(idle):
                continue
            tries -= 1
            steps -= len(idle)
            candidate = msgspec.structs.replace(best, actions=idle)
            if shows(candidate):
                best = candidate
        parts *= 2
    return best


def repro(rollout: Rollout) -> Repro:
    """Convert a rollout to the reproduction of a finding."""
    return Repro(rollout.seed, rollout.actions, dict(rollout.conditions.to_json()))
