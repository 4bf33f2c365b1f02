"""Steps after the end of an episode: flags that become false again, and a reward that is paid too late."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from envcraft.judging.shrink import repro
from envcraft.model.rollout import Conditions
from envcraft.text import plural
from envcraft_checks.endings.flags import deciding_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from envcraft.judging.check import Check
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.model.verdict import Finding

#: How many times larger than each following one a reward is that is paid once, and the episodes that must be paid alike
#: after their end.
_TIMES, _OWING = 2, 5


def find_events(check: Check, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
    """Find what must not happen after the end of an episode: it continues, or its reward of the end comes only then."""
    # An adapter's truncation says nothing about the game, so terminated episodes come first. The steps past the end of
    # doing nothing are known.
    idle = subject.episodes.idle
    ended = [trace for trace in traces if trace.ended]
    if not ended:
        return
    first = min(ended, key=lambda trace: (not trace.terminated[-1], trace is not idle, trace.steps))
    rollout = subject.episodes.past_end(first.rollout)
    trace = subject.rollout(rollout)
    alive = [step for step, (_, terminated, truncated) in enumerate(trace.after, 1) if not (terminated or truncated)]
    if alive:
        yield check.finding(
            "EC505",
            f"{plural(alive[0], 'step')} after its end at step {trace.steps} the episode continues: both flags are "
            "false again",
            line=deciding_line(subject, "terminated" if trace.terminated[-1] else "truncated"),
            repro=repro(rollout),
        )
        return
    yield from _paid_late(check, subject, [*traces, *subject.searches.explored()], trace)


def _paid_late(check: Check, subject: Subject, traces: list[Trace], ended: Trace) -> Iterator[Finding]:
    """Report an episode whose reward of the end is paid once, at the step after its end: one that is larger than
    all others, or the same one in several episodes.
    """
    late, *rest = [reward for reward, _, _ in ended.after] or [0.0]
    largest = max(abs(reward) for trace in traces for reward in trace.rewards)
    # A limit that truncates may come just before an end of the game's own.
    if not rest or not ended.terminated[-1]:
        return
    if abs(late) > max(largest, *(_TIMES * abs(reward) for reward in rest)):
        words = f"no step of {len(traces)} episodes pays or costs more than {largest:g}"
    elif shown := _owed(subject, traces, ended):
        words = f"the same holds in all of {shown} episodes, and none of their last steps pays this reward"
    else:
        return
    yield check.finding(
        "EC508",
        f"the step after the end at step {ended.steps} pays {late:g}, and the next one {rest[0]:g}; {words}: the "
        "reward of the end comes a step late",
        line=subject.line_of("step"),
        repro=repro(ended.rollout),
        late=late,
        largest=largest,
    )


def _owed(subject: Subject, traces: list[Trace], ended: Trace) -> int:
    """How many episodes pay the same once in the first call after their end, which their last steps do not pay and
    most steps do not either; 0 if some episode does not.
    """
    usual, _ = Counter(reward for trace in traces for reward in trace.rewards).most_common(1)[0]
    if ended.after[0][0] == usual or not _owes(ended):
        return 0
    # One of each seed first: different actions on one seed may end alike.
    known = sorted((each for each in traces if each.ended and each.terminated[-1]), key=lambda each: each.steps)
    known = [each for each in known if each.rollout.key() != ended.rollout.under(Conditions()).key()]
    first = list({each.rollout.seed: each for each in reversed(known)}.values())
    chosen = [*first, *(each for each in known if each not in first)][: _OWING - 1]
    seeds = {ended.rollout.seed, *(each.rollout.seed for each in chosen)}
    if len(chosen) < _OWING - 1 or len(seeds) < 2 or not subject.affords(sum(each.steps for each in chosen)):
        return 0
    again = subject.rollouts([subject.episodes.past_end(each.rollout) for each in chosen])
    return _OWING if all(_owes(each) and each.after[0][0] == ended.after[0][0] for each in again) else 0


def _owes(trace: Trace) -> bool:
    """Whether the first call after an episode pays more than its last step, and the second call does not pay it."""
    paid = [reward for reward, _, _ in trace.after]
    over = trace.usable and trace.ended and trace.terminated[-1]
    return over and len(paid) > 1 and abs(paid[0]) > abs(trace.rewards[-1]) and paid[0] != paid[1]
