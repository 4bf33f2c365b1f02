"""The report as SARIF 2.1.0, for code scanning and editors."""

from __future__ import annotations

import json
import os
from collections import Counter
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from envcraft.errors import ExitCode
from envcraft.model.events import Event, Finished
from envcraft.model.identity import fingerprint
from envcraft.model.verdict import Finding, Ignored, Report, SubjectReport, Verdict, plain
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import raising_place
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import Numbered, numbered
from envcraft.text import one_line, relative

if TYPE_CHECKING:
    from envcraft.judging.check import Rule

#: The schema's identifier, which consumers require; nothing is fetched from it.
SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
#: The base of relative locations; the report does not reveal its path on this machine.
_BASE = "SRCROOT"
_STATUS = {
    ExitCode.PASS: "no environment fails",
    ExitCode.FAIL: "at least one environment fails",
    ExitCode.ERROR: "something could not be judged",
}


class SarifReporter(Reporter):
    """One run with every rule declared, a result for each finding, and a notification for what could not be judged.

    The exit code is the one that ``envcraft validate`` has without ``--exit-zero``.
    """

    name = "sarif"
    summary = "SARIF 2.1.0, for code scanning and editors"
    suffix = ".sarif"

    def handle(self, event: Event) -> None:
        if isinstance(event, Finished):
            log = {"$schema": SCHEMA, "version": "2.1.0", "runs": [self._run(event.report)]}
            self.output.write(json.dumps(plain(log), indent=1, allow_nan=False) + "\n")

    def _run(self, report: Report) -> dict[str, Any]:
        codes = {code: index for index, code in enumerate(self.rules)}
        seen: Counter[tuple[str, str]] = Counter()
        results = []
        for item in numbered(report):
            # Two violations of one rule are distinguished by their order.
            nth = (item.subject.path, item.finding.code)
            results.append(_result(item, codes, seen[nth]))
            seen[nth] += 1
        results += [
            _suppressed(subject, place, ignored, codes)
            for place, subject in enumerate(report.reports)
            for check in subject.checks
            for ignored in check.ignored
        ]
        return {
            "tool": {
                "driver": {
                    "name": "EnvCraft",
                    "version": report.envcraft,
                    "rules": [_rule(rule) for rule in self.rules.values()],
                }
            },
            "invocations": [_invocation(report)],
            "originalUriBaseIds": {_BASE: {"description": {"text": "The folder in which envcraft ran."}}},
            "artifacts": [_artifact(subject, number) for number, subject in enumerate(report.reports, 1)],
            "results": results,
            "properties": {"contract": report.contract, "budget": report.budget, "seed": report.seed},
        }


def _rule(rule: Rule) -> dict[str, Any]:
    return {
        "id": rule.code,
        "name": rule.name,
        "shortDescription": {"text": rule.summary},
        "fullDescription": {"text": rule.summary},
        "help": {
            "text": f"{rule.summary}\n\nFix: {rule.fix}\n\nMore: envcraft explain {rule.code}",
            "markdown": f"{rule.summary}\n\n**Fix:** {rule.fix}\n\n**More:** `envcraft explain {rule.code}`",
        },
        "defaultConfiguration": {"enabled": rule.default, "level": rule.severity.value},
        "properties": {"tags": ["environment", "reinforcement-learning"], "problem.severity": rule.severity.value},
    }


def _result(item: Numbered, codes: dict[str, int], nth: int) -> dict[str, Any]:
    finding, subject = item.finding, item.subject
    return {
        **_named(finding, subject, item.place, codes),
        "partialFingerprints": {"envcraft/v1": fingerprint(subject.path, finding.code, nth)},
        "properties": {
            "number": item.number,
            "check": item.check.check,
            "evidence": finding.evidence,
            "reproduction": finding.repro,
        },
    }


def _suppressed(subject: SubjectReport, place: int, ignored: Ignored, codes: dict[str, int]) -> dict[str, Any]:
    """Return the result of a finding that a comment ignores; viewers hide it."""
    named = _named(ignored.finding, subject, place, codes)
    return {**named, "suppressions": [{"kind": "inSource", "justification": one_line(ignored.reason)}]}


def _named(finding: Finding, subject: SubjectReport, place: int, codes: dict[str, int]) -> dict[str, Any]:
    """Return what results have in common: the rule, the level, the message and the location."""
    location = _location(subject, place)
    if subject.module is not None:
        # The reader of the report may not have the file of these lines.
        location["logicalLocations"] = [{"fullyQualifiedName": f"{subject.module}.{subject.env_class}"}]
    elif finding.line is not None and finding.line > 0:
        location["physicalLocation"]["region"] = {"startLine": finding.line}
    rule = {"ruleIndex": codes[finding.code]} if finding.code in codes else {}
    related, elsewhere = [], _elsewhere(finding, subject)
    if elsewhere is not None and finding.line is None:
        location["physicalLocation"] = elsewhere
    elif elsewhere is not None:
        related = [{"physicalLocation": elsewhere, "message": {"text": "The line that raises."}}]
    return {
        "ruleId": finding.code,
        **rule,
        "level": finding.severity.value,
        "message": _message(finding.message),
        "locations": [location],
        **({"relatedLocations": related} if related else {}),
    }


def _elsewhere(finding: Finding, subject: SubjectReport) -> dict[str, Any] | None:
    """Return the line of another file of the project that raises, if one does."""
    place = raising_place(subject, finding)
    return place and {"artifactLocation": _at(place[0]), "region": {"startLine": place[1]}}


def _invocation(report: Report) -> dict[str, Any]:
    verdicts = {subject.verdict for subject in report.reports}
    failed = Verdict.FAIL in verdicts
    status = ExitCode.FAIL if failed else ExitCode.ERROR if Verdict.ERROR in verdicts else ExitCode.PASS
    notifications = [
        {"level": "error", "message": _message(words), "locations": [_location(subject, place)]}
        for place, subject in enumerate(report.reports)
        for words in _troubles(subject)
    ]
    return {
        "executionSuccessful": not notifications,
        "exitCode": status.value,
        "exitCodeDescription": _STATUS[status],
        "toolExecutionNotifications": notifications,
    }


def _troubles(subject: SubjectReport) -> list[str]:
    """Return why a subject, or a check of it, could not be judged."""
    broken = [check for check in subject.checks if check.verdict is Verdict.ERROR]
    if not broken and subject.verdict is Verdict.ERROR:
        return [f"could not be judged: {subject.reason or 'no reason was given'}"]
    return [f"the check {check.check} could not judge: {check.reason}" for check in broken]


def _artifact(subject: SubjectReport, number: int) -> dict[str, Any]:
    skipped = {check.check: check.reason for check in subject.checks if check.verdict is Verdict.SKIP}
    return {
        "location": _place(subject),
        "roles": ["analysisTarget"],
        "sourceLanguage": "python",
        "hashes": {"sha-256": subject.source_sha256},
        "properties": {
            "number": number,
            "class": subject.env_class,
            "verdict": subject.verdict,
            "undecided": subject.undecided,
            "seconds": subject.seconds,
            "steps": subject.steps,
            "isolation": subject.isolation,
            "sandbox": subject.sandbox,
            "skipped": skipped,
        },
    }


def _location(subject: SubjectReport, index: int) -> dict[str, Any]:
    return {"physicalLocation": {"artifactLocation": {**_place(subject), "index": index}}}


def _place(subject: SubjectReport) -> dict[str, Any]:
    return _at(subject.path)


def _at(path: str) -> dict[str, Any]:
    uri, inside = _uri(path)
    return {"uri": uri, "uriBaseId": _BASE} if inside else {"uri": uri}


def _uri(path: str) -> tuple[str, bool]:
    """Return a path as a URI, and whether it is relative to the working directory."""
    seen = relative(path)
    encoded = quote(os.fsencode(seen))
    return (f"file://{encoded}", False) if os.path.isabs(seen) else (encoded, True)


def _message(text: str) -> dict[str, str]:
    """Escape text of an environment, so that it does not become a link."""
    return {"text": one_line(text).replace("](", "] (")}


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [SarifReporter]
