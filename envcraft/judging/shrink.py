"""Make a reproduction smaller while the defect still shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import Skip
from envcraft.model.rollout import Action, Rollout
from envcraft.model.trace import Trace
from envcraft.model.verdict import Finding, Repro

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

#: The steps of the budget for each step of the attempts on one finding.
_PART = 20
#: The share of the steps that the attempts to keep only the last actions take.
_LAST = 0.4


def shrink(
    rollout: Rollout,
    lengths: Iterable[int],
    play: Callable[[Rollout], Trace],
    shown: Callable[[Trace], int | None],
    noop: Any,
    tries: int = 40,
    steps: int = 1_000,
) -> Rollout:
    """Cut the actions after the defect, then remove parts of the others, or replace them by doing nothing.

    The first attempts do nothing throughout, leave out detours (actions between two equal observations), and keep only
    the last actions. Then the parts are halves, quarters, eighths … in turn, as in delta debugging (Zeller and
    Hildebrandt 2002, doi:10.1109/32.988498).

    Args:
        rollout: shows the defect.
        lengths: numbers of actions after which the defect may show, in this order.
        play: runs a rollout.
        shown: the step at which a trace shows the defect; None if it does not.
        noop: the action that does nothing; None if there is none.
        tries: the maximum number of rollouts with other actions.
        steps: the maximum number of their environment steps.

    Returns:
        The smallest rollout that shows the defect, which may be `rollout` itself.
    """
    best = rollout
    try:
        for length in lengths:
            if length < len(rollout.actions) and shown(play(rollout.cut(length))) is not None:
                best = rollout.cut(length)
                break
        if not rollout.policy:
            best = _Shrinking(best, play, shown, noop, tries, steps).run()
    except Skip:
        # The time is over, or no more rollouts may run: what is known is small enough.
        pass
    return best


def shrunk(
    subject: Subject,
    rollout: Rollout,
    finding: Finding,
    find: Callable[[Trace], Iterable[Finding]],
    bounded: bool = True,
) -> Finding:
    """Shrink the reproduction of a finding that one trace shows.

    Args:
        subject: the environment.
        rollout: shows the finding.
        finding: its evidence names the `step` of the defect, or `by` which step it shows; else all actions that were
            taken count.
        find: gives the findings of a trace.
        bounded: whether the attempts take only steps that the budget has left.

    Returns:
        The finding as the smallest episode shows it.
    """

    def again(played: Trace) -> Finding | None:
        return next((found for found in find(played) if found.code == finding.code), None)

    def shown(played: Trace) -> int | None:
        found = again(played)
        if found is None:
            return None
        step: int = found.evidence.get("step", len(played.actions))
        by: int = found.evidence.get("by", step)
        return max(step, by)

    step = finding.evidence.get("step", len(finding.repro.actions))
    lengths = sorted({step, step + 1, max(finding.evidence.get("by", step), step)})
    try:
        left = max(subject.episodes.steps_left, 0) if bounded else subject.budget.steps
        steps = min(subject.budget.steps // _PART, left)
        small = shrink(rollout, lengths, subject.rollout, shown, subject.contract.noop, steps=steps)
        # The shorter episode may show the defect at another step.
        finding = again(subject.rollout(small)) or finding
    except Skip:
        # No more rollouts may run.
        return finding
    return msgspec.structs.replace(finding, repro=repro(small))


class _Shrinking:
    """The attempts to find a smaller rollout, and the smallest one so far."""

    def __init__(
        self,
        best: Rollout,
        play: Callable[[Rollout], Trace],
        shown: Callable[[Trace], int | None],
        noop: Any,
        tries: int,
        steps: int,
    ) -> None:
        self._best = best
        self._play = play
        self._shown = shown
        self._noop = noop
        self._tries = tries
        self._steps = steps
        self._tried: set[str] = {str(best.actions)}

    def run(self) -> Rollout:
        try:
            trace = self._play(self._best)
            straight = self._best
            self._straighten(trace, self._steps // 4)
            if self._noop is not None:
                self._attempt([self._noop] * len(self._best.actions))
            if self._best is straight:
                self._straighten(trace)
            self._keep_last()
            self._divide()
        except Skip:
            pass
        return self._best

    def _attempt(self, actions: list[Action]) -> bool:
        """Try other actions, and keep them if they show the defect; without what follows it, and without detours."""
        if len(actions) > self._steps or not self._tries or str(actions) in self._tried:
            return False
        self._tried.add(str(actions))
        self._tries -= 1
        self._steps -= len(actions)
        candidate = msgspec.structs.replace(self._best, actions=actions)
        trace = self._play(candidate)
        step = self._shown(trace)
        if step is None:
            return False
        self._best = candidate
        if step < len(actions) and self._shown(self._play(candidate.cut(step))) is not None:
            self._best = candidate.cut(step)
        self._straighten(trace)
        return True

    def _straighten(self, trace: Trace, most: int | None = None) -> None:
        """Leave out what lies between equal observations of the smallest rollout, if at most `most` actions stay."""
        actions = self._best.actions
        seen = trace.observations[: len(actions)]
        if trace.opaque or len(seen) < len(actions):
            return
        last = {digest: number for number, digest in enumerate(seen)}
        kept, number = [], 0
        while number < len(actions):
            number = last[seen[number]]
            kept.append(actions[number])
            number += 1
        if most is None or len(kept) <= most:
            self._attempt(kept)

    def _keep_last(self) -> None:
        allowed = self._steps - int(_LAST * self._steps)
        length = 1
        while length < len(self._best.actions) and self._steps - length >= allowed:
            if self._attempt(self._best.actions[-length:]):
                return
            length *= 2

    def _divide(self) -> None:
        """Remove parts, from large to small ones; at a size at which none can go, do nothing in their place."""
        size = -(-len(self._best.actions) // 2)
        while size and self._tries and self._steps:
            known = self._best
            self._pass(size, [])
            if self._best is known and self._noop is not None:
                self._pass(size, [self._noop])
            if size == 1 and self._best is known:
                return
            size = size // 2 or 1

    def _pass(self, size: int, idle: list[Action]) -> None:
        start = 0
        while start < len(self._best.actions):
            actions = self._best.actions
            part = idle * len(actions[start : start + size])
            if not self._attempt(actions[:start] + part + actions[start + size :]) or idle:
                start += size


def repro(rollout: Rollout) -> Repro:
    """Convert a rollout to the reproduction of a finding."""
    return Repro(rollout.seed, rollout.actions, dict(rollout.conditions.to_json()))
