"""Loops of actions that pay each time, and earn more than success does."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Any, NamedTuple

from envcraft.text import plural
from envcraft_checks.linting.program import program_of
from envcraft_checks.rewards.lines import RewardLines, Unknown

from .cycles import TIMES, leads_back
from .successes import best_soon, clearly_more, successes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace

#: The fewest repetitions of a loop.
_REPEATS = 4
#: The steps in which a held action pays each time.
_STEADY = 40
#: How many times more than every success a loop earns where that is an error.
_FAR = 2


class Farmed(NamedTuple):
    """A loop that pays.

    Attributes:
        trace: an episode that repeats it.
        words: what it earns, as a sentence.
        certain: whether it earns far more than every success.
        evidence: the loop, what a repetition pays at least, and the returns that are compared.
    """

    trace: Trace
    words: str
    certain: bool
    evidence: dict[str, Any]


def farmed(subject: Subject, traces: list[Trace]) -> Farmed | None:
    """The first loop that earns clearly more than a success on its seed; where no play succeeds, than all other play.

    Args:
        subject: the environment.
        traces: what was played.
    """
    won = successes([*traces, *subject.privileged()])
    if not won and not any(outcome.get("win") for outcome in subject.searches.explorations):
        return _cycle(subject, traces)
    best = best_soon(traces, max(trace.steps for trace in traces))
    most = max((trace.total for trace in won), default=0.0)
    for number, actions, size in subject.searches.loops:
        success = best.get(subject.episode_seed(number))
        if success is None or not subject.affords(len(actions)):
            continue
        trace = _repeated(subject, number, actions, size, success)
        if trace is None:
            continue
        start = len(actions) - size
        whole = range(start, start + (trace.steps - start) // size * size, size)
        least = min((sum(trace.rewards[at : at + size]) for at in whole), default=0.0)
        if least <= 0:
            continue
        return Farmed(
            trace,
            f"repeating {_in_words(actions[-size:])} pays at least {least:g} each time, without success: "
            f"{trace.total:g} in {plural(trace.steps, 'step')}, while success on the same seed pays "
            f"{success.total:g} in {plural(success.steps, 'step')}",
            trace.total >= _FAR * max(most, 0),
            {"loop": actions[-size:], "gain": least, "earned": trace.total, "success": most},
        )
    return None


def _cycle(subject: Subject, traces: list[Trace]) -> Farmed | None:
    """A loop where no play succeeds: it pays on and on and leads back to the same state, and no other play earns as
    much.
    """
    if not all(trace.usable for trace in subject.played()):
        # What a crash ends could have earned more.
        return None
    longest = max(trace.steps for trace in traces)
    for number, actions, size in [*subject.searches.loops, *_held(subject)]:
        trace = leads_back(subject, number, actions, size)
        if trace is None:
            continue
        first = len(actions) - size
        others = [each for each in traces if size > 1 or set(map(str, each.actions)) != {str(actions[-1])}]
        most = max((each.total for each in others), default=0.0)
        least = min(sum(trace.rewards[at : at + size]) for at in range(first, trace.steps, size))
        earned = trace.total + least * max(longest - trace.steps, 0) / size
        if least > 0 and earned >= clearly_more(most):
            return Farmed(
                trace,
                f"repeating {_in_words(actions[-size:])} pays at least {least:g} each time, {TIMES} times in a "
                f"row, and leads back to the same state; this earns {earned:g} in {plural(longest, 'step')}, while "
                f"no episode succeeds or earns more than {most:g}",
                earned >= max(_FAR * max(most, 0), _largest(subject))
                and _leads_nowhere(subject, number, actions, size, longest),
                {"loop": actions[-size:], "gain": least, "earned": earned, "most": most},
            )
    return None


def _held(subject: Subject) -> Iterator[tuple[int, list[Any], int]]:
    """Held actions that pay at each of many steps, as loops of one action."""
    rewards = Counter(reward for trace in subject.episodes.whole for reward in trace.rewards)
    # None are known if the first step of these episodes raises.
    idle = max(rewards, key=rewards.__getitem__, default=0.0)
    for trace in subject.held():
        # Without success, as in a bandit, the best action is to be held.
        known = trace.usable and trace.reported_success is not None
        if known and trace.steps >= _STEADY and min(trace.rewards[-_STEADY:]) > max(idle, 0):
            yield 0, trace.actions[:_STEADY], 1


def _largest(subject: Subject) -> float:
    """The largest number that the code adds to the reward, such as that of a success that no play has reached."""
    program = program_of(subject)
    try:
        writes = RewardLines(program).writes() if program is not None else []
    except Unknown:
        return 0.0
    return max((write.sign * write.amount for write in writes if write.amount is not None), default=0.0)


def _leads_nowhere(subject: Subject, number: int, actions: list[Any], size: int, longest: int) -> bool:
    """Whether info reports no success up to the end of an episode that repeats a loop."""
    if not subject.searches.spares(longest):
        return False
    repeats = max(longest - len(actions), 0) // size
    trace = subject.searches.scripted(number, [*actions, *actions[-size:] * repeats], "a loop of actions")
    lost = trace.ended and trace.terminated[-1]
    return trace.usable and trace.reported_success is False and not lost


def _repeated(subject: Subject, number: int, actions: list[Any], size: int, success: Trace) -> Trace | None:
    """An episode that repeats a loop to its end, or until it earns clearly more than success; None if it succeeds, is
    lost, or earns less.
    """
    once = subject.searches.scripted(number, actions, "a loop of actions")
    gain, left = sum(once.rewards[-size:]), subject.length - len(actions)
    if not once.usable or once.ended or gain <= 0:
        return None
    least = clearly_more(success.total)
    repeats = max(math.ceil((least - once.total) / gain) + 1, _REPEATS)
    if repeats * size > left:
        return None
    if subject.affords(subject.length):
        repeats = left // size
    elif not subject.affords(repeats * size + len(actions)):
        return None
    trace = subject.searches.scripted(number, [*actions, *actions[-size:] * repeats], "a loop of actions")
    lost = trace.ended and trace.terminated[-1]
    if not trace.usable or trace.reported_success or lost or trace.total < least:
        return None
    return trace


def _in_words(actions: list[Any]) -> str:
    if len({str(action) for action in actions}) > 1:
        return str(actions)
    return str(actions[0]) if len(actions) == 1 else f"{actions[0]} {len(actions)} times"
