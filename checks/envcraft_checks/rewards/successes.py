"""The episodes that end with reported success, which loops and failures are compared with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from envcraft.model.rollout import Rollout

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The share by which a return must exceed another.
_CLEARLY = 0.25
#: The share of the longest episode within which a success comes soon.
SOON = 0.5


def clearly_more(earned: float) -> float:
    """The least return that is clearly more than another."""
    return earned + max(_CLEARLY * abs(earned), 1e-6)


def successes(traces: list[Trace]) -> list[Trace]:
    """The episodes that end with reported success, each once."""
    return list({trace.rollout.key(): trace for trace in traces if trace.ended and trace.reported_success}.values())


def best_soon(traces: list[Trace], limit: int) -> dict[int, Trace]:
    """The success with the highest return on each seed, of those that come soon if there are any."""
    best: dict[int, Trace] = {}
    for trace in successes(traces):
        known = best.setdefault(trace.rollout.seed, trace)
        worth = [(each.steps <= limit * SOON, each.total) for each in (trace, known)]
        if worth[0] > worth[1]:
            best[trace.rollout.seed] = trace
    return best


def direct_successes(subject: Subject, traces: list[Trace]) -> list[Trace]:
    """Successes without detours, on seeds where steps pay and no success comes soon.

    A search follows what pays, so where each step does, it comes to a success late, if at all. Actions that lead back
    to the same observation are left out.
    """
    limit = max(trace.steps for trace in traces) * SOON
    soonest: dict[int, Trace] = {}
    for trace in sorted(successes(traces), key=lambda trace: trace.steps):
        soonest.setdefault(trace.rollout.seed, trace)
    found = []
    for trace in soonest.values():
        if trace.steps > limit and not trace.opaque and sum(reward > 0 for reward in trace.rewards) > trace.steps / 2:
            actions = _without_detours(trace)
            if len(actions) <= limit and subject.affords(len(actions)):
                player = f"{trace.rollout.player} without detours"
                found.append(subject.rollout(Rollout(trace.rollout.seed, actions, player=player)))
    return [trace for trace in found if trace.usable]


def _without_detours(trace: Trace) -> list[Any]:
    """The actions of an episode, without those between two equal observations."""
    last = {observation: step for step, observation in enumerate(trace.observations[: trace.steps])}
    actions, step = [], 0
    while step < trace.steps:
        step = last[trace.observations[step]]
        actions.append(trace.actions[step])
        step += 1
    return actions
