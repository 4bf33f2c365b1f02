"""The report as workflow commands, which GitHub Actions shows as annotations of lines."""

from __future__ import annotations

import os

from envcraft.model.events import Event, Finished, SubjectFinished
from envcraft.model.target import Kind
from envcraft.model.verdict import Finding, Severity, SubjectReport, Verdict
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import raising_place
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import summary_words, unsettled
from envcraft.text import one_line, relative


class GitHubReporter(Reporter):
    """An annotation for each finding and each check that could not judge, as its subject ends, and a summary.

    GitHub shows ten errors and ten warnings of one step; all of them are in the log.
    """

    name = "github"
    summary = "annotations of a GitHub Actions run"

    def handle(self, event: Event) -> None:
        if isinstance(event, SubjectFinished):
            self._subject(event.report)
        elif isinstance(event, Finished):
            missing = {layer for subject in event.report.reports for layer in subject.sandbox.missing}
            words = f"{summary_words(event.report)} (contract {one_line(event.report.contract)})"
            if missing:
                words += f"\nNot in force on this machine: {one_line('; '.join(sorted(missing)))}"
            self._annotate("notice", words, title="EnvCraft")

    def _subject(self, report: SubjectReport) -> None:
        # An installed environment has no file in the repository, so the message names it.
        own = report.kind is Kind.SOURCE
        file = _in_repository(report.path) if own else ""
        named = "" if own else f"{one_line(report.path)}: "
        undecided = unsettled(report)
        for check in report.checks:
            for finding in check.findings:
                self._finding(report, file, finding)
            if check in undecided:
                title = f"EnvCraft: {one_line(check.check)} is undecided and fails under --strict"
                self._annotate("error", named + one_line(check.reason), file=file, title=title)
            if check.verdict is Verdict.ERROR:
                title = f"EnvCraft: {one_line(check.check)} could not judge"
                self._annotate("error", named + one_line(check.reason), file=file, title=title)
        if report.verdict is Verdict.ERROR and not any(check.verdict is Verdict.ERROR for check in report.checks):
            self._annotate("error", named + one_line(report.reason), file=file, title="EnvCraft: could not be judged")

    def _finding(self, report: SubjectReport, file: str, finding: Finding) -> None:
        rule = self.rules.get(finding.code)
        line = str(finding.line) if finding.line else ""
        message = one_line(finding.message)
        if not line and (raising := raising_place(report, finding)) is not None:
            file, line = _in_repository(raising[0]), str(raising[1])
        if not file:
            message = f"{one_line(report.file)}{line and f':{line}'}: {message}"
        if rule is not None:
            message += f"\nFix: {rule.fix}\nMore: envcraft explain {rule.code}"
        self._annotate(
            "error" if finding.severity is Severity.ERROR else "warning",
            message,
            file=file,
            line=line if file else "",
            title=" ".join(["EnvCraft", one_line(finding.code), rule.name if rule else ""]).rstrip(),
        )

    def _annotate(self, command: str, message: str, **properties: str) -> None:
        given = ",".join(f"{name}={_property(value)}" for name, value in properties.items() if value)
        # GitHub does not show an empty message.
        self.write(f"::{command} {given}::{_data(message or 'no message')}\n")


def _in_repository(path: str) -> str:
    return one_line(relative(path, os.environ.get("GITHUB_WORKSPACE")))


def _data(text: str) -> str:
    """Escape a command's message, so that it stays one line."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    """Escape a command's property, which commas and colons end."""
    return _data(text).replace(":", "%3A").replace(",", "%2C")


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [GitHubReporter]
