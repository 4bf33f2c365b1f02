"""The rules for privileged policies, which the check ``difficulty`` and the recording of demonstrations share."""

from __future__ import annotations

from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.trace import Trace, diverge
from envcraft.model.verdict import Finding, Repro

RULES = (
    Rule("EC804", "policy-writes", "The privileged policy changes the environment.", "Only read the state."),
    Rule("EC805", "policy-fails", "The privileged policy raises or chooses no valid action.", "Fix the policy."),
)


def judge_play(check: Check, trace: Trace) -> Finding | None:
    """Judge what a policy did in an episode that it played.

    Args:
        check: The check that reports the finding; :data:`RULES` are among its rules.
        trace: The trace of the episode.

    Returns:
        The first finding, or None.
    """
    at, reproduction = trace.steps + 1, Repro(trace.rollout.seed, trace.actions)
    if trace.refused:
        return check.finding("EC805", f"the policy's action {len(trace.chosen)} is invalid: {trace.refused}")
    fault = trace.fault
    if fault is not None and (fault.phase == "policy write" or fault.type.endswith("ReadOnlyState")):
        words = f"the policy writes to the environment at step {at}: {fault.message}"
        return check.finding("EC804", words, line=fault.line, repro=reproduction, step=at)
    if fault is not None and fault.phase == "policy":
        words = f"the policy raises {fault} at step {at}"
        return check.finding("EC805", words, line=fault.line, repro=reproduction, traceback=fault.traceback)
    if trace.choosing and trace.end is not None:
        words = f"the policy does not choose action {at} ({trace.end.reason}: {trace.end.detail})"
        return check.finding("EC805", words, repro=reproduction, **trace.printed)
    return None


def judge_effect(check: Check, trace: Trace, plain: Trace) -> Finding | None:
    """Compare an episode that a policy played with `plain`, the same actions without the policy.

    Infos are not compared, because clock readings in them differ between runs.
    """
    if (divergence := diverge(trace, plain, info=False)) is None:
        return None
    return check.finding(
        "EC804",
        f"the policy's actions give another trace without the policy: {divergence}",
        repro=repro(plain.rollout.cut(divergence.step)),
        step=divergence.step,
        field=divergence.field,
    )
