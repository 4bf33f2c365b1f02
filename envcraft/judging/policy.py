"""The rules for privileged policies, which the check ``difficulty`` and the recording of demonstrations share."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import ClockShift, Conditions, Rollout
from envcraft.model.trace import Fault, Trace, diverge
from envcraft.model.verdict import Finding, Repro

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

#: A process with other addresses, whose generators without a seed differ, too.
_ANEW = Conditions(fresh=True, heap=1)
#: The global generators are reseeded before each call, and the clock counts its readings: what a policy draws or how
#: long it thinks changes neither.
_CONTROLLED = Conditions(perturb=1, clock=ClockShift(offset=0.0, rate=0.0))

RULES = (
    Rule(
        "EC804",
        "policy-writes",
        "The privileged policy changes the environment.",
        "Only read the state.",
        about_policy=True,
    ),
    Rule(
        "EC805",
        "policy-fails",
        "The privileged policy raises or chooses no valid action.",
        "Fix the policy.",
        about_policy=True,
    ),
)


def judge_play(check: Check, subject: Subject, trace: Trace) -> Finding | None:
    """Judge what a policy did in an episode that it played.

    Args:
        check: The check that reports the finding; :data:`RULES` are among its rules.
        subject: The environment.
        trace: The trace of the episode.

    Returns:
        The first finding, or None.
    """
    at, reproduction = trace.steps + 1, Repro(trace.rollout.seed, trace.actions)
    if trace.refused:
        return check.finding("EC805", f"the policy's action {len(trace.chosen)} is invalid: {trace.refused}")
    fault = trace.fault
    if fault is not None and (fault.phase == "policy write" or fault.type.endswith("ReadOnlyState")):
        words = f"the policy writes to the environment at step {at}: {fault.message}{_place(subject, fault)}"
        return check.finding("EC804", words, repro=reproduction, step=at)
    if fault is not None and fault.phase == "policy":
        words = f"the policy raises {fault} at step {at}{_place(subject, fault)}"
        return check.finding("EC805", words, repro=reproduction, traceback=fault.traceback)
    if trace.choosing and trace.end is not None:
        words = f"the policy does not choose action {at} ({trace.end.reason}: {trace.end.detail})"
        return check.finding("EC805", words, repro=reproduction, **trace.printed)
    return None


def _place(subject: Subject, fault: Fault) -> str:
    """Where the policy goes wrong, in words: the line of a finding is one of the environment's file."""
    path = subject.policy.path if subject.policy is not None else "policy"
    return f" ({path}:{fault.line})" if fault.line is not None else f" ({path})"


def judge_effect(check: Check, subject: Subject, trace: Trace, plain: Trace) -> Finding | None:
    """Compare an episode that a policy played with `plain`, the same actions without the policy.

    Infos are not compared, because clock readings in them differ between runs.

    A difference is no finding if the environment makes it by itself, under the same seed and the same actions.

    Args:
        check: The check that reports the finding; :data:`RULES` are among its rules.
        subject: The environment.
        trace: The trace of the episode.
        plain: Its actions without the policy.

    Returns:
        The finding, or None.
    """
    divergence = diverge(trace, plain, info=False)
    if divergence is None or _differs_alone(subject, plain.rollout.cut(divergence.step), plain):
        return None
    if _same_when_controlled(subject, trace.rollout):
        return None
    return check.finding(
        "EC804",
        f"the policy's actions give another trace without the policy: {divergence}",
        repro=repro(plain.rollout.cut(divergence.step)),
        step=divergence.step,
        field=divergence.field,
    )


def _differs_alone(subject: Subject, rollout: Rollout, plain: Trace) -> bool:
    """Whether the environment gives another trace if the same actions are repeated without the policy."""
    divergence = diverge(plain, subject.rollout(rollout.under(_ANEW), alone=True), info=False)
    # The repetition is shorter.
    return divergence is not None and divergence.step <= len(rollout.actions)


def _same_when_controlled(subject: Subject, rollout: Rollout) -> bool:
    """Whether the policy has no effect where the global generators and the clock are the same with and without it."""
    acted = subject.rollout(rollout.under(_CONTROLLED), alone=True)
    alone = Rollout(rollout.seed, acted.actions, _CONTROLLED, player="the policy's actions without it")
    return acted.usable and diverge(acted, subject.rollout(alone, alone=True), info=False) is None
