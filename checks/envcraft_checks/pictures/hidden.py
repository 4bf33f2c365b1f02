"""State that no picture shows and that decides about rewards and losses."""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import TYPE_CHECKING

from envcraft.model.rollout import Rollout

from .traces import Defect, shows_pictures

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The fewest events that follow from hidden state, their share of all, and how much likelier a picture may make one.
_HIDDEN, _MOST, _TOLD = 10, 0.75, 2
#: The losses that are examined, those that must depend on hidden state, and the latest step of one.
_LOSSES, _UNSEEN, _SOON = 8, 3, 60
#: The share of the budget that these may take.
_SHARE = 0.08
#: The most steps of doing nothing before the last action, and those that must not change a picture: what is drawn may
#: move only every few steps.
_WAITS, _STILL = 6, 16


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


def find_unseen(subject: Subject, traces: list[Trace]) -> Defect | None:
    """Find losses by what no picture shows: after doing nothing, which changes no picture, the same action does not
    lose.
    """
    noop, outcomes = subject.contract.noop, subject.searches.explorations
    pictured = shows_pictures(subject.observation_space)
    if noop is None or not pictured or any(outcome.get("stochastic", True) for outcome in outcomes):
        return None
    lost = [trace for trace in traces if _is_lost(trace) and 1 < trace.steps <= _SOON]
    unseen: list[tuple[Trace, int]] = []
    seen, left = 0, int(subject.budget.steps * _SHARE)
    for loss in sorted(lost, key=lambda trace: trace.steps)[:_LOSSES]:
        cost = (_WAITS + 1) * (loss.steps + _WAITS) + _STILL
        left -= cost
        if left < 0 or not subject.affords(cost):
            break
        changes, waited = _survived(subject, loss, noop)
        seen += changes
        unseen += [(loss, waited)] if waited else []
        if seen >= _UNSEEN and not unseen:
            return None
    if len(unseen) < _UNSEEN or len({loss.rollout.seed for loss, _ in unseen}) < 2:
        return None
    loss, waited = unseen[0]
    return Defect(
        f"no picture shows the cause of a loss: in {len(unseen)} episodes the last action does not lose if it is taken "
        f"some steps later, for example {waited} steps after step {loss.steps}, although no picture changes before it "
        "and the game draws no random numbers during play",
        loss.rollout.cut(loss.steps),
        {"losses": len(unseen), "step": loss.steps, "waited": waited},
    )


def _is_lost(trace: Trace) -> bool:
    """Whether an episode ends without success, and its last step pays less than most steps."""
    if not (trace.usable and trace.ended and trace.terminated[-1]) or trace.opaque or trace.reported_success:
        return False
    return trace.rewards[-1] < Counter(trace.rewards).most_common(1)[0][0]


def _survived(subject: Subject, loss: Trace, noop: object) -> tuple[bool, int]:
    """Do nothing for some steps before the last action of an episode that is lost.

    Returns:
        Whether this changes a picture, and the number of steps after which the action does not lose, 0 if it always
        does.
    """
    before, last = loss.actions[: loss.steps - 1], loss.actions[loss.steps - 1]

    def later(waits: int) -> Trace:
        actions = [*before, *[noop] * waits, last]
        return subject.rollout(Rollout(loss.rollout.seed, actions, player="the same action later"))

    still = later(_STILL)
    if any(shown != loss.observations[-2] for shown in still.observations[len(before) : len(before) + _STILL + 1]):
        return True, 0
    for waits in range(1, _WAITS + 1):
        trace = later(waits)
        if not trace.usable or trace.steps < len(before) + waits + 1:
            break
        if not trace.terminated[-1]:
            return False, waits
    return False, 0
