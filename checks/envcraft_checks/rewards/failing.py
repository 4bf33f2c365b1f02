"""Episodes that fail and earn more than success does."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import msgspec

from .successes import SOON, clearly_more, successes

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The successes that make an error.
_SUCCESSES = 3


class Failing(NamedTuple):
    """A failure that pays more than success.

    Attributes:
        failure: an episode of one held action, or a loss.
        success: the success on its seed that earns the least beside it.
        shown: how many successes earn clearly less than a failure on their seed, and have none that earns more.
        won: how many successes there are.
        certain: whether there are enough of them, or the last steps of two are punished.
    """

    failure: Trace
    success: Trace
    shown: int
    won: int
    certain: bool


def failing_pays(subject: Subject, traces: list[Trace]) -> Failing | None:
    """The failure that earns the most beside a success on its seed, if failing pays more on every seed with a success.

    Args:
        subject: the environment.
        traces: what was played.
    """
    won = successes(traces)
    pays = max((trace.rewards[-1] for trace in won), default=0.0)
    shown: list[tuple[Trace, Trace]] = []
    for seed in dict.fromkeys(trace.rollout.seed for trace in won):
        same = [trace for trace in won if trace.rollout.seed == seed]
        failed = [trace for trace in subject.played() if trace.rollout.seed == seed and _fails(trace, pays)]
        idle = subject.contract.noop is not None and not any(_is_idle(trace) for trace in failed)
        if idle and subject.affords(subject.length):
            trace = subject.rollout(msgspec.structs.replace(subject.probes.noop(), seed=seed))
            failed += [trace] if _fails(trace, pays) else []
        if not failed:
            return None
        failure = max(failed, key=lambda trace: trace.total)
        # A success that comes late shares what waiting for it pays; a loss that is paid pays in one step.
        paid = failure.terminated[-1] and failure.rewards[-1] > pays
        soon = [trace for trace in same if paid or trace.steps <= failure.steps * SOON]
        if any(failure.total < clearly_more(max(trace.total, pays)) for trace in soon):
            return None
        if any(trace.total > clearly_more(failure.total) for trace in same):
            return None
        shown += [(failure, trace) for trace in soon]
    if not shown:
        return None
    failure, success = max(shown, key=lambda pair: pair[0].total - pair[1].total)
    usual = Counter(reward for trace in traces for reward in trace.rewards).most_common(1)[0][0]
    punished = len(shown) > 1 and pays < min(usual, 0.0)
    return Failing(failure, success, len(shown), len(won), punished or len(shown) >= _SUCCESSES)


def _fails(trace: Trace, pays: float) -> bool:
    """Whether an episode ends without success although it holds one action, or with a loss that pays more than the
    step that wins `pays`.
    """
    if not trace.ended or trace.reported_success:
        return False
    return len({str(action) for action in trace.actions}) == 1 or (trace.terminated[-1] and trace.rewards[-1] > pays)


def _is_idle(trace: Trace) -> bool:
    return trace.rollout.player == "doing nothing"
