"""What the checks found, told to a model: in plain words, with the trace around it, the reproduction and the lines."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from envcraft.check import Rule
from envcraft.cli import offered
from envcraft.verdict import Finding, Severity, SubjectReport, Verdict, plain

#: What the later stages judge: nothing of this is repaired.
LATER = frozenset({"instawin", "instadeath", "difficulty"})
#: So many findings are told of, and so many lines and actions of each.
_MOST, _AROUND, _ACTIONS = 6, 4, 40
#: So many characters of a value that is evidence.
_VALUE = 1200


def findings(report: SubjectReport | None, of: frozenset[str] | None = None) -> list[Finding]:
    """The findings that fail a check; of these checks alone, where `of` names some."""
    checks = report.checks if report is not None else []
    return [
        finding
        for check in checks
        if of is None or check.check in of
        for finding in check.findings
        if finding.severity is Severity.ERROR
    ]


def to_repair(report: SubjectReport | None) -> list[Finding]:
    """The findings that a repair is for."""
    checks = frozenset(check.check for check in report.checks) if report is not None else frozenset()
    return findings(report, checks - LATER)


def verdict_of(report: SubjectReport, check: str) -> Verdict | None:
    """What one check said; None where it did not run."""
    return next((found.verdict for found in report.checks if found.check == check), None)


def brief_words(found: list[Finding]) -> str:
    """The findings in one line, for a reason."""
    return "; ".join(f"{finding.code} {finding.message}" for finding in found[:3])


def told(found: list[Finding], source: str) -> str:
    """The findings as Markdown, each with what it takes to understand it."""
    return "\n\n".join(_one(finding, source) for finding in found[:_MOST])


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
    """All rules by code, of whichever plugin they come."""
    return {rule.code: rule for check in offered("envcraft_checks") for rule in check.rules}


def lines_of(found: list[Finding]) -> Iterator[str]:
    """The findings, a line each."""
    for finding in found:
        yield f"{finding.code}: {finding.message}"
