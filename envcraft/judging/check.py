"""The interface of checks: families of rules that are judged on traces in the trusted process.

A check requests rollouts from the :class:`~envcraft.judging.subject.Subject` and yields findings. It never sees the
environment. The docstring of its module is the page that ``envcraft explain`` prints.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.model.verdict import CheckReport, Finding, Line, Repro, Severity

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace


class Rule(msgspec.Struct, frozen=True):
    """One code that a check can report.

    Attributes:
        code: a stable identifier of capitals and digits. EnvCraft's own codes are ``EC`` and three digits.
        name: a few words in kebab-case.
        summary: the defect, in one sentence.
        fix: the usual fix, in one sentence.
        severity: ``error`` fails the check, ``warning`` does not.
        waiver: the setting of a contract that waives it, if that is not ``without``: ``render = "optional"``.
        confirmed_by: codes of errors that earlier checks report for the same defect. After one of them, this rule
            reports nothing.
        default: whether the rule reports anything unless ``--select`` or a severity names it.
        gate: whether an error of it skips the checks that follow, because they could not run.
        about_policy: whether it judges the privileged policy. For the author who names the policy, an error of it is a
            usage error, not a finding about the environment.
    """

    code: str
    name: str
    summary: str
    fix: str
    severity: Severity = Severity.ERROR
    waiver: str = ""
    confirmed_by: tuple[str, ...] = ()
    default: bool = True
    gate: bool = False
    about_policy: bool = False

    @property
    def status(self) -> str:
        """The severity, and a note if the rule is off by default."""
        return self.severity.value if self.default else f"{self.severity.value}, off by default"


class Check(ABC):
    """A rule family.

    Attributes:
        name: the value for ``--checks``.
        rules: the codes that it can report.
        gate: whether its failure skips the other checks, because they could not run. A gate runs before them, even if
            it is not selected.
        always: whether it runs even if it is not selected, because no verdict can be trusted without it. It runs after
            all other checks.
        opt_in: whether it runs only if ``--checks`` names it, because it costs far more than the others.
        hash_seeds: the PYTHONHASHSEED of each additional worker that it needs in nearly every run.
    """

    name: str
    rules: tuple[Rule, ...]
    gate: bool = False
    always: bool = False
    opt_in: bool = False
    hash_seeds: tuple[int, ...] = ()

    @abstractmethod
    def judge(self, subject: Subject) -> Iterator[Finding]:
        """Yield a finding for each defect of the subject.

        Raises:
            Skip: the check does not apply; the message is the reason.
        """

    def find(self, subject: Subject, trace: Trace) -> Iterable[Finding]:
        """Yield the findings of one trace that need no other trace. By default there are none."""
        return ()

    def conclude(self, subject: Subject, reports: Sequence[CheckReport]) -> Iterable[Finding]:
        """Yield findings that only the reports of all checks of a subject show. By default there are none.

        The last check concludes first.
        """
        return ()

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        """Run a finding's reproduction again.

        By default, this runs the whole check again, which requests the same rollouts under the same seed.

        Args:
            subject: the environment.
            finding: the finding to reproduce.

        Returns:
            The finding if the defect shows again, else None.
        """
        return next((again for again in self.judge(subject) if again.code == finding.code), None)

    def rule(self, code: str) -> Rule:
        """Return the rule with this code.

        Raises:
            KeyError: the check has no such rule.
        """
        for rule in self.rules:
            if rule.code == code:
                return rule
        raise KeyError(code)

    def waivable(self, code: str) -> bool:
        """Whether an author may ignore or lower a code of this check: not if other verdicts depend on it."""
        return not (self.always or self.stops(code))

    def stops(self, code: str) -> bool:
        """Whether nothing else can be judged after a finding of this code."""
        rule = self.rule(code)
        return (self.gate or rule.gate) and rule.severity is Severity.ERROR

    def finding(
        self,
        code: str,
        message: str,
        *,
        line: int | Line | None = None,
        repro: Repro | None = None,
        **evidence: Any,
    ) -> Finding:
        """Create a finding of one of this check's rules.

        Args:
            code: of the rule.
            message: one sentence for the user.
            line: of the file, if the defect has one. That of an inherited method names its class in the message.
            repro: the rollout that shows the defect.
            evidence: further data for the report, as JSON values.
        """
        severity = self.rule(code).severity
        if isinstance(line, Line):
            message, line = f"{message}; {line.note}" if line.note else message, line.number
        return Finding(code, severity, message, line, evidence, repro if repro is not None else Repro())

    @property
    def page(self) -> str:
        """The check's documentation: its module's docstring."""
        return inspect.cleandoc(inspect.getmodule(type(self)).__doc__ or "")
