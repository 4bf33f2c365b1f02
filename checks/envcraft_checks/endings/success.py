"""Successes that do not end the episode, or end it as truncated."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.judging.shrink import repro

from .flags import returned_flags

if TYPE_CHECKING:
    from collections.abc import Iterator

    from envcraft.judging.check import Check
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace
    from envcraft.model.verdict import Finding

#: Steps of an episode that goes on after its success.
_AFTER = 30


def find_ongoing(check: Check, subject: Subject) -> Iterator[Finding]:
    """Find episodes that go on after their success, though only time passes there."""
    later = [(trace, step) for trace in subject.searches.onward if (step := _first(trace)) > 1]
    later = [(trace, step) for trace, step in later if trace.steps - step >= _AFTER]
    if len(later) < 2 or any(trace.terminated[-1] for trace, _ in later) or not later[0][0].reported_success:
        return
    (idle, step), *_ = later
    paid = {reward for trace, at in later for reward in trace.rewards[at:]}
    again = set(idle.rewards[step:])
    if len(paid) == 1 and max(paid) <= 0 and all(trace.reported_success for trace, _ in later):
        words = "which pay nothing"
    elif len(again) == 1 and min(again) > 0 and subject.contract.noop is not None:
        words = f"and doing nothing earns {min(again):g} at each of them"
    else:
        return
    yield check.finding(
        "EC506",
        f"info reports success at step {step}, but the episode goes on for {idle.steps - step} more steps, {words}",
        line=subject.line_of("step"),
        repro=repro(idle.rollout.cut(step + _AFTER)),
        step=step,
        episodes=len(later),
    )


def find_truncated(check: Check, subject: Subject, traces: list[Trace]) -> Iterator[Finding]:
    """Find a success whose only flag is truncated, though no time limit is there: other play goes on longer."""
    known = [*traces, *subject.searches.explored()]
    for trace in known:
        if not _is_truncated(trace):
            continue
        longer = [other for other in known if other.rollout.seed == trace.rollout.seed and other.steps > trace.steps]
        if longer:
            line, words = returned_flags(subject)
            yield check.finding(
                "EC507",
                f"the success at step {trace.steps} is truncated, not terminated, but this is not a time limit: "
                f"{longer[0].rollout.player} plays longer on the same seed{words}",
                line=line,
                repro=repro(trace.rollout.cut(trace.steps)),
                step=trace.steps,
            )
            return


def _first(trace: Trace) -> int:
    """The first step whose info reports success; 0 if none does."""
    key = trace.rule.key
    return next((step for step in range(1, trace.steps + 1) if trace.info(step).get(key)), 0)


def _is_truncated(trace: Trace) -> bool:
    """Whether an episode is only truncated at the first step at which info reports success."""
    cut = trace.ended and trace.truncated[-1] and not trace.terminated[-1]
    return cut and bool(trace.reported_success) and trace.steps > 1 and _first(trace) == trace.steps
