"""Make a reproduction smaller while the defect still shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from envcraft.model.rollout import Rollout
from envcraft.model.verdict import Repro


def shrink(rollout: Rollout, step: int, shows: Callable[[Rollout], bool], noop: Any, tries: int = 16) -> Rollout:
    """Cut the actions after `step`, then replace runs of those before it by doing nothing.

    Halves, quarters, eighths … are tried in turn, as in delta debugging (Zeller & Hildebrandt 2002,
    doi:10.1109/32.988498), `tries` rollouts at the most. Gives `rollout` itself when nothing smaller shows the defect.
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
            if idle == best.actions or tries <= 0:
                continue
            tries -= 1
            candidate = msgspec.structs.replace(best, actions=idle)
            if shows(candidate):
                best = candidate
        parts *= 2
    return best


def repro(rollout: Rollout) -> Repro:
    """A rollout as a finding states it."""
    return Repro(rollout.seed, rollout.actions, dict(rollout.conditions.to_json()))
