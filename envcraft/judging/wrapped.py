"""Whether the wrappers of an environment cause a finding, by one more episode without them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import EnvCraftError, Skip
from envcraft.judging.check import Check
from envcraft.model.job import ExitReason
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Repro
from envcraft.spaces.validation import validate_action

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject

_METHODS = (None, "__init__", "reset", "step", "render", "close")


class _Unknown(Exception):
    """One episode does not show whether wrappers cause a finding."""


def with_wrappers_named(check: Check, subject: Subject, finding: Finding) -> Finding:
    """Say in a finding which wrappers cause it, or may do so.

    What the environment does without its wrappers, too, is reported as if it had none.

    Args:
        check: reported the finding.
        subject: an environment with wrappers.
        finding: names no line and no method of the environment where the environment's code may not be the cause.
    """
    if not subject.constructed:
        return finding
    wrappers = subject.target.wrappers
    names = f"the wrapper{'s' if len(wrappers) > 1 else ''} {' and '.join(wrappers)}"
    # A finding that knows no better line names that of a method.
    vague = finding.line in {subject.line_of(method).number for method in _METHODS}
    try:
        alone = _alone(check, subject, finding)
    except (_Unknown, Skip, EnvCraftError):
        if not vague and finding.repro == Repro():
            # The code alone shows it.
            return finding
        words = f"judged in {names}"
    else:
        if alone is not None:
            return msgspec.structs.replace(finding, line=alone.line)
        words = f"without {names} it does not occur"
    # What play shows may be the wrappers' doing: only the line of an exception certainly ran.
    vague = vague or "traceback" not in finding.evidence
    if not vague:
        return msgspec.structs.replace(finding, message=f"{finding.message}; {words}")
    message = finding.message
    for note in {subject.line_of(method).note for method in _METHODS} - {""}:
        message = message.removesuffix(f"; {note}")
    return msgspec.structs.replace(finding, message=f"{message}; {words}", line=None)


def _alone(check: Check, subject: Subject, finding: Finding) -> Finding | None:
    """The finding of the same episode without wrappers; None if there is none. Raises _Unknown."""
    bare = subject.without_wrappers
    if check.gate:
        if subject.load().end.reason is not ExitReason.DONE:
            # A constructor that does not end would take as long again.
            raise _Unknown
        return check.confirm(bare, finding)
    conditions = Conditions.from_json(finding.repro.conditions)
    rollout = Rollout(finding.repro.seed, finding.repro.actions, conditions)

    def shown(played: Subject) -> Finding | None:
        found = check.find(played, played.rollout(rollout))
        return next((one for one in found if one.code == finding.code), None)

    if any(validate_action(bare.action_space, action) for action in rollout.actions):
        raise _Unknown
    if shown(subject) is not None:
        return shown(bare)
    if finding.repro.conditions and type(check).confirm is not Check.confirm:
        # The check only compares this episode with the same one under these conditions.
        return check.confirm(bare, finding)
    raise _Unknown
