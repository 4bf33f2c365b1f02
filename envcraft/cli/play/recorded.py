"""Episodes that a person played, as findings, so that reports hold them and ``envcraft replay`` plays them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from envcraft.errors import Skip
from envcraft.judging.check import Check, Rule
from envcraft.judging.shrink import repro
from envcraft.model.rollout import Conditions, Rollout
from envcraft.model.verdict import Finding, Severity

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace


class Played(Check):
    """A check for ``envcraft play`` and ``envcraft replay`` only; it never judges."""

    name = "play"
    rules = (Rule("EC000", "played", "A person played this episode.", "No fix is needed.", Severity.WARNING),)

    def judge(self, subject: Subject) -> Iterator[Finding]:
        raise Skip("a person plays, and no rule judges how")

    def find(self, subject: Subject, trace: Trace) -> Iterator[Finding]:
        from envcraft.cli.play.game import result
        from envcraft.model.trace import digest

        words = f"a person played seed {trace.rollout.seed}: {result(trace)}"
        evidence: dict[str, Any] = {
            "return": trace.total,
            "steps": trace.steps,
            "success": trace.success,
            "trace": digest(trace),
        }
        yield self.finding("EC000", words, repro=repro(trace.rollout), **evidence)

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        conditions = Conditions.from_json(finding.repro.conditions)
        trace = subject.rollout(Rollout(finding.repro.seed, finding.repro.actions, conditions))
        again = next(self.find(subject, trace))
        return again if again.evidence["trace"] == finding.evidence.get("trace") else None
