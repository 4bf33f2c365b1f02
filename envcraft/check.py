"""What a check is: a rule, judged on traces in the trusted process.

A check asks the :class:`~envcraft.subject.Subject` for rollouts and yields findings. It never sees the environment. The
module that defines it is its documentation: the docstring is the page that ``envcraft explain`` prints.
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.verdict import Finding, Repro, Severity

if TYPE_CHECKING:
    from envcraft.subject import Subject
    from envcraft.trace import Trace


class Rule(msgspec.Struct, frozen=True):
    """One code that a check can report.

    Attributes:
        code: stable identifier, capitals and digits: ``EC`` and three digits for those of EnvCraft itself.
        name: a few words in kebab-case.
        summary: what the rule says, in one sentence.
        fix: what usually mends it, in one sentence.
        severity: ``error`` fails the check, ``warning`` only tells.
    """

    code: str
    name: str
    summary: str
    fix: str
    severity: Severity = Severity.ERROR


class Skip(Exception):
    """Raised by a check that cannot say anything about this subject, with the reason."""


class Check(ABC):
    """A rule family.

    Attributes:
        name: how ``--checks`` names it.
        rules: the codes that it can report.
        always: run even when not selected, since no verdict can be trusted without it, and after all others.
        opt_in: run only when ``--checks`` names it, since it costs far more than the others.
        hash_seeds: PYTHONHASHSEED of each worker that it is sure to need besides the ordinary ones.
    """

    name: str
    rules: tuple[Rule, ...]
    always: bool = False
    opt_in: bool = False
    hash_seeds: tuple[int, ...] = ()

    @abstractmethod
    def judge(self, subject: Subject) -> Iterator[Finding]:
        """Yield what is wrong with the subject. Raises Skip."""

    def find(self, subject: Subject, trace: Trace) -> Iterable[Finding]:
        """What one trace shows by itself, whatever else was played: by default nothing."""
        return ()

    def confirm(self, subject: Subject, finding: Finding) -> Finding | None:
        """Run a finding's reproduction again: the finding if the defect shows, else None.

        By default the whole check is judged again, which under the same seed asks for the same rollouts.
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
