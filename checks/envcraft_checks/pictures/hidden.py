"""State that no picture shows and that decides about rewards."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from .traces import Defect, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The fewest events that follow from hidden state, their share of all, and how much likelier a picture may make one.
_HIDDEN, _MOST, _TOLD = 10, 0.75, 2


def find_hidden(subject: Subject, traces: list[Trace]) -> Defect | None:
    """Find state that is not drawn and decides about most rewards, where chance does not."""
    outcomes = subject.searches.explorations
    if not shows_pictures(subject.observation_space) or any(outcome.get("stochastic", True) for outcome in outcomes):
        return None
    by_picture: dict[tuple[bytes, str], Counter[tuple[float, bool]]] = defaultdict(Counter)
    by_action: dict[str, Counter[tuple[float, bool]]] = defaultdict(Counter)
    for trace in traces:
        for step, chosen in enumerate(trace.given[: trace.steps]):
            action, result = str(chosen), (trace.rewards[step], trace.terminated[step])
            by_picture[trace.observations[step], action][result] += 1
            by_action[action][result] += 1
    every: Counter[tuple[float, bool]] = sum(by_action.values(), Counter())
    usual = every.most_common(1)[0][0]
    events = every.total() - every[usual]
    hidden = 0
    for (_, action), counts in by_picture.items():
        whole = by_action[action]
        for result, count in counts.items():
            # A picture tells something of a result that follows it more often than other pictures.
            told = count >= _TOLD * counts.total() * whole[result] / whole.total()
            hidden += count if len(counts) > 1 and result != usual and not told else 0
    if hidden < _HIDDEN or hidden < _MOST * events:
        return None
    return Defect(
        f"no picture shows when {hidden} of {events} events occur (rewards other than {usual[0] + 0.0:g}, and "
        "terminations): the same action at the same picture also had another result, although the game draws no "
        "random numbers during play",
        traces[0].rollout.cut(traces[0].steps),
        {"hidden": hidden, "events": events},
    )
