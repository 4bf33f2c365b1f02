"""The report with one line for each finding, as compilers print them, for editors and for grep."""

from __future__ import annotations

from envcraft.model.events import Event, Finished, SubjectFinished
from envcraft.model.verdict import Finding, Severity, SubjectReport, Verdict
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import place_of
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import summary_words, unsettled
from envcraft.text import one_line


class ConciseReporter(Reporter):
    """Write ``path:line: code message``, without the line where a finding has none, and a summary at the end.

    A line is written as soon as its subject is judged, so subjects that are judged side by side are not in order.
    """

    name = "concise"
    summary = "one line for each finding, as compilers print: path:line: code message"

    def handle(self, event: Event) -> None:
        if isinstance(event, SubjectFinished):
            for line in _lines(event.report):
                self.write(f"{line}\n")
        elif isinstance(event, Finished) and self.verbosity >= 0:
            self.write(f"{summary_words(event.report)}\n")


def _lines(report: SubjectReport) -> list[str]:
    # A check's own trouble is at no line of a file.
    name = one_line(report.path)
    lines = [_line(report, finding) for check in report.checks for finding in check.findings]
    # Without these lines, a failure would have none.
    lines += [
        f"{name}: error: the check {one_line(check.check)} is undecided and fails under --strict: "
        f"{one_line(check.reason)}"
        for check in unsettled(report)
    ]
    lost = [
        f"{name}: error: the check {one_line(check.check)} could not judge: {one_line(check.reason)}"
        for check in report.checks
        if check.verdict is Verdict.ERROR
    ]
    if report.verdict is Verdict.ERROR and not lost:
        lost = [f"{name}: error: could not be judged: {one_line(report.reason)}"]
    return lines + lost


def _line(report: SubjectReport, finding: Finding) -> str:
    warning = " (warning)" if finding.severity is Severity.WARNING else ""
    return f"{one_line(place_of(report, finding))}: {one_line(finding.code)}{warning} {one_line(finding.message)}"


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [ConciseReporter]
