"""The interface of checks: families of rules that are judged on traces in the trusted process.

A check requests rollouts from the :class:`~envcraft.judging.subject.Subject` and yields findings. It never sees the
environment. The docstring of its module is the page that ``envcraft explain`` prints.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.model.verdict import Finding, Repro, Severity

if TYPE_CHECKING:
    from envcraft.judging.subject import Subject
    from envcraft.model.trace import Trace


class Rule(msgspec.Struct, frozen=True):
    """One code that a check can report.

    Attributes:
        code: stable identifier, capitals and digits: ``EC`` and three digits for those of EnvCraft itself.
        name: a few words in kebab-case.
        summary: what the rule says, in one sentence.
        fix: the usual fix, in one sentence.
        severity: ``error`` fails the check, ``warning`` does not.
    """

    code: str
    name: str
    summary: str
    fix: str
    severity: Severity = Severity.ERROR


class Check(ABC):
    """A rule family.

    Attributes:
        name: how ``--checks`` names it.
        rules: the codes that it can report.
        gate: the other checks are skipped when it fails, since there is nothing that they could run. A gate runs before
            them, even when it is not selected.
        always: it runs even when it is not selected, since no verdict can be trusted without it, and after all others.
        opt_in: it runs only when ``--checks`` names it, since it costs far more than the others.
        hash_seeds: the PYTHONHASHSEED of each worker that it is sure to need besides the ordinary ones.
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
            Skip: the check has nothing to judge here, with the reason.
        """

    def find(self, subject: Subject, trace: Trace) -> Iterable[Finding]:
        """Yield the findings of one trace that need no other trace. By default there are none."""
        return ()

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        """Run a finding's reproduction again. By default this judges the whole check again, which requests the same
        rollouts under the same seed.

        Returns:
            The finding if the defect shows again, else None.
        """
        return next((found for found in self.judge(subject) if found.code == finding.code), None)

    def rule(self, code: str) -> Rule:
        """The rule with this code. Raises KeyError."""
        for rule in self.rules:
            if rule.code == code:
                return rule
        raise KeyError(code)

    def finding(
        self,
        code: str,
        message: str,
        *,
        line: int | None = None,
        repro: Repro | None = None,
        **evidence: Any,
    ) -> Finding:
        """Make a finding of one of this check's rules."""
        severity = self.rule(code).severity
        return Finding(code, severity, message, line, evidence, repro if repro is not None else Repro())

    @property
    def page(self) -> str:
        """The check's documentation: its module's docstring."""
        return inspect.cleandoc(inspect.getmodule(type(self)).__doc__ or "")
