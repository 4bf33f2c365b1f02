"""Whether a mutant behaves like its game: long replays of both in the sandbox, under many conditions."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import msgspec

from envcraft.errors import Skip
from envcraft.judging.engine import Plan, open_subject
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout
from envcraft.model.trace import Trace, digest

#: Episodes of random play, and of random actions that are held for a while.
_RANDOM, _STICKY = 12, 6
#: Resets before an episode.
_RESETS = 40
#: The longest time of all replays of one mutant, in seconds.
_SECONDS = 1200.0
#: Rendered frames that are compared.
_FRAMES = 40


def equivalent(original: Plan, mutant: Plan, pool: WorkerPool) -> bool:
    """Whether no replay differs. Each plan names one target; contract, budget and seed must be the same.

    A mutant that could not be replayed to the end is not equivalent.
    """
    original, mutant = (msgspec.structs.replace(plan, time_limit=_SECONDS) for plan in (original, mutant))
    with open_subject(original, original.targets[0], pool) as one, open_subject(mutant, mutant.targets[0], pool) as two:
        try:
            return all(seen(one.rollout(rollout)) == seen(two.rollout(rollout)) for rollout in replays(one))
        except Skip:
            return False


def replays(game: Subject) -> Iterator[Rollout]:
    """What is replayed: plain episodes with each joint action held too, then some under other conditions."""
    probes = game.probes
    found = [trace.rollout for trace in game.searches.explored() if trace.usable]
    yield from found
    for number in range(_RANDOM):
        yield probes.random(number)
    for number in range(_STICKY):
        yield probes.sticky(number)
    for action in probes.joint_actions:
        yield probes.hold(action)
    others = [Episode(rollout.seed, rollout.actions) for rollout in found]
    others += [Episode(9_000 + number, probes.random(number).actions) for number in range(3)]
    resets = [Episode(9_100 + number, []) for number in range(_RESETS)]
    idle = probes.hold(probes.joint_actions[0])
    for rollout in [probes.random(0), probes.random(1), probes.sticky(0), idle, *found[:2]]:
        again = Episode(rollout.seed, rollout.actions)
        for conditions in (
            Conditions(reread=True, options=True, closed=True),
            Conditions(render=True),
            Conditions(hash_seed=1),
            Conditions(global_seed=11, perturb=11),
            Conditions(clock=ClockShift(1e7, 0.5)),
            Conditions(again=True),
            Conditions(companion=others[-1]),
            Conditions(after_end=5),
            Conditions(before=[*others, again, *resets]),
            Conditions(before=[again], unseeded=True),
        ):
            yield msgspec.structs.replace(rollout, conditions=conditions, keep=_FRAMES)


def seen(trace: Trace) -> tuple[Any, ...]:
    """Everything that can be observed of an episode, apart from its time, and from the picture of a terminal state: no
    action follows it, and its value is zero by definition.
    """
    if trace.ended and trace.terminated[-1] and len(trace.observations) == trace.steps + 1 > 1:
        frames = trace.frames[: trace.steps]
        trace = dataclasses.replace(trace, observations=trace.observations[:-1], frames=frames)
    return (
        digest(trace),
        trace.reward_types,
        trace.flag_types,
        trace.problems,
        trace.render_problems,
        trace.overwritten,
        trace.acted,
        trace.info_notes,
        trace.after,
        [frame.tobytes() for frame in (*trace.frames, *trace.rendered)],
        str(trace.fault),
        trace.end and trace.end.reason,
        seen(trace.earlier) if trace.earlier is not None else None,
    )
