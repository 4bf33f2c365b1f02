"""Episodes that a person played, as findings of a check of its own: so that a report holds them, with what was wrong in
them, and ``envcraft replay`` plays them again.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from envcraft.check import Check, Rule, Skip
from envcraft.rollout import Conditions, Rollout
from envcraft.shrink import repro
from envcraft.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace


class Played(Check):
    """Not among the checks that judge: only ``envcraft play`` and ``envcraft replay`` know it."""

    name = "play"
    rules = (Rule("EC000", "played", "A person played this episode.", "Nothing needs mending.", Severity.WARNING),)

    def judge(self, subject: Subject) -> Iterator[Finding]:
        raise Skip("a person plays, and nothing judges how")

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        from envcraft.trace import digest

        from .game import result

        words = f"a person played seed {trace.rollout.seed}: {result(trace)}"
        told: dict[str, Any] = {
            "return": trace.total,
            "steps": trace.steps,
            "success": trace.success,
            "trace": digest(trace),
        }
        yield self.finding("EC000", words, repro=repro(trace.rollout), **told)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        conditions = Conditions.from_json(finding.repro.conditions)
        trace = subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions))
        again = next(self.find(subject, trace))
        return again if again.evidence["trace"] == finding.evidence.get("trace") else None
