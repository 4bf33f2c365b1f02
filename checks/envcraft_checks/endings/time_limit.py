"""Time limits that an episode outlasts, or that are reported as termination."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from envcraft.judging.shrink import repro
from envcraft_checks.linting.evading import restarted, unlimited
from envcraft_checks.linting.limits import step_limit, terminates_at
from envcraft_checks.linting.program import in_words, program_of

from .flags import returned_flags

if TYPE_CHECKING:
    from collections.abc import Iterator

    from envcraft.judging.check import Check
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.model.verdict import Finding

#: Steps without a change after which a held action is played to the end of its episode.
_STILL = 30


def find_wrong(check: Check, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
    """Find episodes that the contract's limit does not end, and limits that terminate what reaches them.

    A limit of the game's own that only the code calls one is reported last, if play shows no other defect.
    """
    still = _standstill(subject)
    known = traces if still is None else [*traces, still]
    found = [
        *_endless(check, subject, known, limit),
        *_terminating(check, subject, known, limit),
        *_swapped(check, subject, traces, limit),
    ]
    yield from found or _named(check, subject, traces)


def find_evaded(check: Check, subject: Subject, limit: int) -> Iterator[Finding]:
    """Find a step limit that the code lets play evade, where no episode has lasted long enough to show it.

    If a counter must start again more than once for that, a search looks for play that does it.
    """
    program = program_of(subject)
    if program is None or "limit" in subject.contract.adapter:
        return
    suspects = list(unlimited(program, limit))
    if suspects:
        words, lines = in_words(suspects)
        yield check.finding(
            "EC501",
            f"{words}, so an episode can last longer than {limit:,} steps",
            line=suspects[0].line,
            lines=lines,
        )
        return
    restart = restarted(program, limit)
    if restart is None:
        return
    name, most, suspect = restart
    actions = subject.searches.outlast(name, most)
    trace = subject.searches.scripted(0, actions, "a search for restarts") if actions else None
    if trace is not None and trace.usable and not trace.ended and trace.steps >= limit:
        yield check.finding(
            "EC501",
            f"an episode does not end within {limit:,} steps: line {suspect.line} {suspect.words}, again and again",
            line=suspect.line,
            repro=repro(trace.rollout),
        )


def find_paused(check: Check, subject: Subject) -> Iterator[Finding]:
    """Find a held action that stops the counter of the code's own step limit, under a contract without a limit."""
    program = program_of(subject)
    limit = step_limit(program) if program is not None else None
    still = _still(subject)
    if limit is None or limit < 1 or still is None or not subject.affords(2 * int(limit)):
        return
    twice = subject.probes.hold(still.rollout.actions[0], length=2 * int(limit))
    paused = subject.rollout(twice)
    if paused.usable and not paused.ended:
        yield check.finding(
            "EC501",
            f"{twice.player} does not end the episode within {paused.steps:,} steps, and the code has a limit of"
            f" {limit:,.0f}",
            line=subject.line_of("step"),
            repro=repro(twice),
        )


def _standstill(subject: Subject) -> Trace | None:
    """A whole episode of the first held action that stops all change, as a pause does; None if there is none."""
    still = _still(subject)
    if still is None:
        return None
    whole = subject.probes.hold(still.rollout.actions[0])
    return subject.rollout(whole) if subject.affords(len(whole.actions)) else None


def _still(subject: Subject) -> Trace | None:
    """The first held action that stops all change; None if there is none."""
    for trace in subject.held():
        tail = trace.observations[-_STILL:]
        if not trace.ended and trace.usable and trace.steps >= _STILL and len(set(tail)) == 1:
            return trace
    return None


def _endless(check: Check, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
    """Report episodes that go on at the contract's limit."""
    endless = [trace for trace in traces if not trace.ended and trace.steps >= limit]
    if endless:
        players = list(dict.fromkeys(trace.rollout.player for trace in endless))
        yield check.finding(
            "EC501",
            f"{len(endless)} of {len(traces)} episodes do not end within {limit:,} steps: {', '.join(players[:4])}",
            line=subject.line_of("step"),
            repro=repro(endless[0].rollout),
            episodes=len(endless),
            of=len(traces),
        )


def _terminating(check: Check, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
    """Report the contract's limit where it terminates all that reach it."""
    # One episode may be lost at the last step by chance; several are ended by the limit.
    last = [trace for trace in traces if trace.ended and trace.steps == limit]
    if len(last) == 1 and _is_mistaken(last[0], both=True):
        last += [trace for trace in _others(subject, last[0]) if trace.ended and trace.steps == limit]
    if len(last) >= 2 and all(_is_mistaken(trace, both=True) for trace in last):
        wrong = "and truncated" if all(trace.truncated[-1] for trace in last) else "not truncated"
        line, words = returned_flags(subject)
        yield check.finding(
            "EC502",
            f"all {len(last)} episodes that reach step {limit} are terminated there, {wrong}{words}",
            line=line,
            repro=repro(last[0].rollout),
            episodes=len(last),
        )


def _swapped(check: Check, subject: Subject, traces: list[Trace], limit: int) -> Iterator[Finding]:
    """Report a limit of the game's own with swapped flags: the longest episodes terminate, all others truncate."""
    longest = max(trace.steps for trace in traces)
    last = [trace for trace in traces if trace.steps == longest]
    short = [trace for trace in traces if trace.ended and trace.steps < longest]
    if longest >= limit or not all(map(_is_mistaken, last)):
        return
    short += [trace for trace in subject.searches.explored() if trace.ended and trace.steps < longest]
    cut = all(trace.truncated[-1] and not trace.terminated[-1] for trace in short)
    if not cut or len({trace.steps for trace in short}) < 2:
        return
    if len({trace.rollout.seed for trace in last}) < 2:
        last += [trace for trace in _others(subject, last[0]) if trace.steps == longest]
    if len({trace.rollout.seed for trace in last}) >= 2 and all(map(_is_mistaken, last)):
        line, words = returned_flags(subject)
        yield check.finding(
            "EC502",
            f"all {len(last)} episodes that reach step {longest} are terminated there, and all {len(short)} that "
            f"end sooner are truncated{words}",
            line=line,
            repro=repro(last[0].rollout.cut(longest)),
            episodes=len(last),
            sooner=len(short),
        )


def _named(check: Check, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
    """Report a limit of the game's own that the code calls a time limit, and that terminates all that reach it."""
    program = program_of(subject)
    named = terminates_at(program) if program is not None else None
    if named is None:
        return
    steps, suspect = named
    last = [trace for trace in traces if trace.ended and trace.steps == steps]
    if last and len({trace.rollout.seed for trace in last}) < 2:
        # What the code says and one episode shows is worth one more than the budget has.
        last += [trace for trace in _others(subject, last[0]) if trace.ended and trace.steps == steps]
    # A game may punish who is too late, as a rule of its own.
    alike = all(_is_mistaken(trace) and trace.rewards[-1] >= min(trace.rewards[:-1]) for trace in last)
    if alike and len({trace.rollout.seed for trace in last}) > 1:
        yield check.finding(
            "EC502",
            f"all {len(last)} episodes that reach step {steps} are terminated there, not truncated: line "
            f"{suspect.line} {suspect.words}",
            line=suspect.line,
            repro=repro(last[0].rollout.cut(steps)),
            episodes=len(last),
        )


def _is_mistaken(trace: Trace, both: bool = False) -> bool:
    """Whether an episode terminates without success, where its limit should truncate it; `both` includes one that is
    truncated, too.

    If info reports no success, an end that pays more than any step before it is a goal, such as to survive so long.
    """
    if trace.reported_success is None and trace.rule.sign and trace.steps > 1:
        goal = trace.rewards[-1] > max(0.0, *trace.rewards[:-1])
    else:
        goal = bool(trace.reported_success)
    return trace.ended and trace.terminated[-1] and (both or not trace.truncated[-1]) and not goal


def _others(subject: Subject, trace: Trace) -> list[Trace]:
    """The same actions on two other seeds, or on one if the budget does not allow two."""
    numbers = [number for number in range(3) if subject.episode_seed(number) != trace.rollout.seed]
    numbers = numbers[: 2 if subject.affords(2 * trace.steps) else 1]
    seeds = map(subject.episode_seed, numbers)
    return subject.rollouts([msgspec.structs.replace(trace.rollout, seed=seed) for seed in seeds])
