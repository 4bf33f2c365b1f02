"""Findings as text for a model: message, rule, lines of the source, reproduction and measured values."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from envcraft.judging.check import Rule
from envcraft.model.verdict import Finding, Severity, SubjectReport, Verdict, plain
from envcraft.registry import offered

#: Checks that later stages decide; their findings are not repaired.
FILTER_CHECKS = frozenset({"instawin", "instadeath", "difficulty"})
#: Maximum number of findings, of lines before and after a finding, and of actions.
_FINDINGS, _AROUND, _ACTIONS = 6, 4, 40
#: Maximum length of a value of the evidence, in characters.
_VALUE = 1200


def findings(report: SubjectReport | None, of: frozenset[str] | None = None) -> list[Finding]:
    """Return the findings that fail a check; only of the checks in `of`, unless it is None."""
    checks = report.checks if report is not None else []
    return [
        finding
        for check in checks
        if of is None or check.check in of
        for finding in check.findings
        if finding.severity is Severity.ERROR
    ]


def warnings(report: SubjectReport | None, code: str) -> list[Finding]:
    """Return the findings with this code, which fail no check."""
    checks = report.checks if report is not None else []
    return [finding for check in checks for finding in check.findings if finding.code == code]


def to_repair(report: SubjectReport | None) -> list[Finding]:
    """Return the findings that a repair has to remove."""
    checks = frozenset(check.check for check in report.checks) if report is not None else frozenset()
    return findings(report, checks - FILTER_CHECKS)


def check_verdict(report: SubjectReport, check: str) -> Verdict | None:
    """Return the verdict of one check; None if it did not run."""
    return next((result.verdict for result in report.checks if result.check == check), None)


def summary_line(found: list[Finding]) -> str:
    """Return the findings in one line, as the reason of an outcome."""
    return "; ".join(f"{finding.code} {finding.message}" for finding in found[:3])


def findings_markdown(found: list[Finding], source: str) -> str:
    """Return the findings as Markdown, with rule, lines, reproduction and evidence."""
    return "\n\n".join(_one(finding, source) for finding in found[:_FINDINGS])


def _one(finding: Finding, source: str) -> str:
    rule = rules().get(finding.code)
    parts = [f"### {finding.code}{f' ({rule.name})' if rule else ''}", finding.message]
    if rule is not None:
        parts.append(f"What the rule says: {rule.summary} What usually mends it: {rule.fix}")
    if finding.line is not None:
        parts.append(f"The lines around line {finding.line}:\n\n{_lines(source, finding.line)}")
    if finding.repro.actions or finding.repro.conditions:
        parts.append(_reproduction(finding))
    evidence = {name: value for name, value in finding.evidence.items() if value not in (None, "", [], {})}
    trace = evidence.pop("traceback", "")
    if trace:
        parts.append(f"What was raised:\n\n```\n{str(trace)[-_VALUE:].strip()}\n```")
    if evidence:
        measured = "; ".join(f"{name} {_value(value)}" for name, value in evidence.items())
        parts.append(f"Measured: {measured}")
    return "\n\n".join(parts)


def _reproduction(finding: Finding) -> str:
    actions = finding.repro.actions
    steps = f"{len(actions)} step" + ("s" if len(actions) != 1 else "")
    shown = json.dumps(plain(actions[-_ACTIONS:]))
    last = f"the last {_ACTIONS} of them " if len(actions) > _ACTIONS else ""
    words = f"To see it: `reset(seed={finding.repro.seed})`, then {steps}, {last}`{shown}`."
    if finding.repro.conditions:
        words += f" Run under other conditions: `{json.dumps(plain(finding.repro.conditions))}`."
    return words


def _lines(source: str, line: int) -> str:
    lines = source.splitlines()
    first = max(line - 1 - _AROUND, 0)
    shown = [
        f"{number:4}{'>' if number == line else ' '} {text}"
        for number, text in enumerate(lines[first : line + _AROUND], first + 1)
    ]
    return "```\n" + "\n".join(shown) + "\n```"


def _value(value: Any) -> str:
    text = json.dumps(plain(value))
    return text if len(text) <= _VALUE else f"{text[:_VALUE]}…"


def rules() -> dict[str, Rule]:
    """Return the rules of all plugins by code."""
    return {rule.code: rule for check in offered("envcraft_checks") for rule in check.rules}


def finding_lines(found: list[Finding]) -> Iterator[str]:
    """Yield one line for each finding."""
    for finding in found:
        yield f"{finding.code}: {finding.message}"
