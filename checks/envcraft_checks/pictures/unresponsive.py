"""Observations that are the same under all actions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .traces import Defect

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace


def find_unresponsive(subject: Subject, traces: list[Trace]) -> Defect | None:
    """Find observations that are equal in all episodes of a seed, as far as both last."""
    compared, longest = 0, None
    by_seed: dict[int, list[Trace]] = {}
    for trace in traces:
        by_seed.setdefault(trace.rollout.seed, []).append(trace)
    for same in by_seed.values():
        for trace in same[1:]:
            if trace.rollout.actions == same[0].rollout.actions:
                continue
            if _seen_apart(same[0], trace):
                return None
            if subject.contract.observation is None and _paid_apart(same[0], trace):
                # As in a bandit, or a memory task: the reward reflects the actions.
                return None
            compared += 1
            longest = trace if longest is None or trace.steps > longest.steps else longest
    if compared < 3 or longest is None or longest.steps < 2:
        return None
    first = subject.episodes.whole[0]
    if any(_seen_apart(first, trace) for trace in subject.episodes.more_held()):
        return None
    return Defect(
        f"on the same seed the observations do not depend on the actions ({compared} comparisons, "
        f"up to {longest.steps} steps)",
        longest.rollout.cut(longest.steps),
        {"compared": compared},
    )


def _seen_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.observations, two.observations, strict=False))


def _paid_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.rewards, two.rewards, strict=False))
