"""Observations that are the same under all actions, in whole episodes or from some step on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from envcraft.model.rollout import Rollout

from .traces import Defect

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The steps in which no action has an effect: a stun or an animation is shorter.
_DEAD = 150
#: One step in so many acts.
_RARE = 32
#: The steps of an episode of which the last ones are compared.
_SEEN = 600


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


def find_dead(subject: Subject) -> Defect | None:
    """Find play in which other actions lead to the same observations and rewards from some step on, under a contract
    with a limit.

    One episode acts at each step, and one now and then: what is used up by acting lasts in it.
    """
    # Slow to import, and commands that list the rules must start fast.
    from envcraft.judging.actions import random_actions, sticky_actions

    first = subject.episodes.whole[0]
    steps = min(first.steps, _SEEN)
    if subject.contract.limit is None or first.terminated[-1:] == [True] or steps < 2 * _DEAD:
        return None
    start = steps - _DEAD
    rare = Rollout(subject.episode_seed(1), _rarely(subject, steps), player=f"an action in {_RARE} steps")
    for number, order in enumerate((random_actions, sticky_actions)):
        if not subject.searches.spares(steps * (1 + number)):
            return None
        trace = subject.rollout(rare) if number else first
        if trace.steps < steps or len(set(trace.rewards[start:steps])) > 1:
            return None
        others = order(subject.action_space, trace.rollout.seed + 1, _DEAD)
        player = f"other actions after step {start}"
        other = subject.rollout(Rollout(trace.rollout.seed, trace.actions[:start] + others, player=player))
        same = trace.usable and other.usable and not trace.opaque and other.steps == steps
        if not same or other.observations != trace.observations[: steps + 1] or other.rewards != trace.rewards[:steps]:
            return None
    return Defect(
        f"in an episode of random play and one with an action in {_RARE} steps, other actions change nothing in the"
        f" {_DEAD} steps after step {start}",
        first.rollout.cut(steps),
        {"step": start, "steps": _DEAD},
    )


def _rarely(subject: Subject, steps: int) -> list[Any]:
    """Random actions, between which nothing is done."""
    from envcraft.judging.actions import random_actions

    drawn = random_actions(subject.action_space, subject.episode_seed(1), steps)
    still = subject.joint_actions[0]
    return [still if step % _RARE else action for step, action in enumerate(drawn)]


def _seen_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.observations, two.observations, strict=False))


def _paid_apart(one: Trace, two: Trace) -> bool:
    return any(first != second for first, second in zip(one.rewards, two.rewards, strict=False))
