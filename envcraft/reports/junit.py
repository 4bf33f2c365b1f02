"""The report as JUnit XML, with a suite for each environment and a case for each check."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from itertools import islice
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from envcraft.model.events import Event, Finished
from envcraft.model.verdict import CheckReport, Report, Severity, SubjectReport, Verdict, plain
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import place_of
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import Numbered, numbered, reason_words, replay_command, repro_words
from envcraft.text import one_line, plural, printable

_COUNTED = {"failure": "failures", "error": "errors", "skipped": "skipped"}


class JUnitReporter(Reporter):
    """A check that fails is a failure, one that could not judge an error, one that was left out is skipped.

    The details of each finding are in the case's output, also those of warnings, which fail nothing.
    """

    name = "junit"
    summary = "JUnit XML, for continuous integration"
    suffix = ".xml"

    def handle(self, event: Event) -> None:
        if isinstance(event, Finished):
            root = self._suites(event.report)
            indent(root)
            # Character references can be written to a stream of any encoding.
            xml = tostring(root, encoding="us-ascii", xml_declaration=True)
            self.output.write(xml.decode("ascii") + "\n")

    def _suites(self, report: Report) -> Element:
        root = Element("testsuites", name="envcraft")
        items = numbered(report)
        for subject in report.reports:
            suite = SubElement(root, "testsuite", name=one_line(subject.path))
            properties = SubElement(suite, "properties")
            for name, value in _properties(report, subject):
                SubElement(properties, "property", name=name, value=one_line(value))
            for check in subject.checks:
                self._case(suite, report, subject, check, list(islice(items, len(check.findings))))
            if subject.verdict is Verdict.ERROR and not any(check.verdict is Verdict.ERROR for check in subject.checks):
                lost = CheckReport("subject", Verdict.ERROR, reason=subject.reason)
                self._case(suite, report, subject, lost, [])
            _count(suite, subject.seconds)
        _count(root, sum(subject.seconds for subject in report.reports))
        return root

    def _case(
        self, suite: Element, report: Report, subject: SubjectReport, check: CheckReport, items: list[Numbered]
    ) -> None:
        case = SubElement(
            suite,
            "testcase",
            classname=one_line(subject.path),
            name=one_line(check.check),
            time=f"{check.seconds:.3f}",
        )
        reason = reason_words(check)
        if check.verdict is Verdict.FAIL:
            errors = [item.finding for item in items if item.finding.severity is Severity.ERROR]
            lines = [f"{one_line(error.code)}: {one_line(error.message)}" for error in errors]
            more = f" (and {plural(len(lines) - 1, 'more finding')})" if len(lines) > 1 else ""
            failure = SubElement(case, "failure", message=(lines[0] if lines else reason) + more)
            failure.set("type", ", ".join(dict.fromkeys(one_line(error.code) for error in errors)))
            failure.text = "\n".join([*lines, reason] if reason else lines)
        elif check.verdict is Verdict.ERROR:
            SubElement(case, "error", message=reason, type="error").text = reason
        elif check.verdict is Verdict.SKIP:
            SubElement(case, "skipped", message=reason)
        if items:
            SubElement(case, "system-out").text = "\n\n".join(self._details(report, item) for item in items)

    def _details(self, report: Report, item: Numbered) -> str:
        finding, rule = item.finding, self.rules.get(item.finding.code)
        name = f" {rule.name}" if rule else ""
        place = one_line(place_of(item.subject, finding))
        parts = [
            f"#{item.number} {one_line(finding.code)}{name} ({finding.severity}) {place}",
            one_line(finding.message),
        ]
        parts += [f"fix: {rule.fix}"] if rule else []
        parts += [f"{one_line(key)}: {_value(value)}" for key, value in finding.evidence.items() if value is not None]
        parts += [
            f"reproduction: {repro_words(finding.repro)}",
            one_line(json.dumps(plain(finding.repro))),
            printable(replay_command(report, item)),
        ]
        return "\n".join(parts)


def _properties(report: Report, subject: SubjectReport) -> Iterator[tuple[str, str]]:
    yield "envcraft", report.envcraft
    yield "contract", report.contract
    yield "budget", report.budget
    yield "seed", str(report.seed)
    yield "class", subject.env_class or ""
    yield "source_sha256", subject.source_sha256
    yield "verdict", subject.verdict
    yield "undecided", " ".join(subject.undecided)
    yield "steps", str(subject.steps)
    yield "isolation", subject.isolation
    yield "driver", subject.driver
    if subject.sandbox.missing:
        yield "not in force", "; ".join(subject.sandbox.missing)


def _count(element: Element, seconds: float) -> None:
    """Set the attributes that count the cases below."""
    cases = list(element.iter("testcase"))
    kinds = Counter(child.tag for case in cases for child in case)
    element.set("tests", str(len(cases)))
    for tag, attribute in _COUNTED.items():
        element.set(attribute, str(kinds[tag]))
    element.set("time", f"{seconds:.3f}")


def _value(value: object) -> str:
    """Format evidence: text unchanged, anything else as JSON."""
    text = value if isinstance(value, str) else json.dumps(plain(value))
    return f"\n{printable(text)}" if "\n" in text else one_line(text)


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [JUnitReporter]
