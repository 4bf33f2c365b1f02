"""The report for people: a block for each finished subject, and a summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, TextIO

from envcraft.model.events import Event, Finished, SubjectFinished, SubjectStarted
from envcraft.model.verdict import CheckReport, Finding, Report, Severity, SubjectReport, Verdict
from envcraft.plugins import hookimpl
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import repro_words
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from envcraft.judging.check import Rule

STYLES = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.SKIP: "bright_black", Verdict.ERROR: "magenta"}
_BADGES = {verdict: f"bold white on {style}" for verdict, style in STYLES.items()}
SIGNS = {Verdict.PASS: "✓", Verdict.FAIL: "✗", Verdict.SKIP: "-", Verdict.ERROR: "!"}
_WARNING = "yellow"
_PRINTED_LINES, _PRINTED_WIDTH = 3, 200


class ConsoleReporter(Reporter):
    """Print colours and wrapped text on a terminal, plain unwrapped text elsewhere."""

    name = "console"
    summary = "for people: a block for each environment (default)"

    def __init__(self, output: TextIO, rules: Mapping[str, Rule], console: Console | None = None) -> None:
        super().__init__(output, rules)
        self._given = console
        self._findings = 0
        self._numbers: dict[str, int] = {}
        self._waiting: dict[int, SubjectReport] = {}
        self._shown = 0

    @cached_property
    def _console(self) -> Console:
        # Slow to import, so only once something is judged.
        from rich.console import Console

        return self._given or Console(file=self.output, highlight=False, markup=False, emoji=False)

    @property
    def _signs(self) -> bool:
        return self._console.encoding.lower().startswith("utf")

    def handle(self, event: Event) -> None:
        if isinstance(event, SubjectStarted):
            self._numbers[event.path] = event.number
        elif isinstance(event, SubjectFinished):
            # In the order of the report, because findings are numbered across subjects.
            self._waiting[self._numbers.get(event.report.path, self._shown + 1)] = event.report
            while (report := self._waiting.pop(self._shown + 1, None)) is not None:
                self._shown += 1
                self._subject(report)
        elif isinstance(event, Finished):
            self._summary(event.report)

    def _subject(self, report: SubjectReport) -> None:
        title = _text()
        title.append(f" {report.verdict.upper():<5}", _BADGES[report.verdict])
        title.append("  ").append(one_line(report.path), "bold")
        self._say(title)
        facts = [
            one_line(report.env_class) if report.env_class else "no class",
            f"{report.isolation} isolation" + (f" by {report.driver}" if report.driver != report.isolation else ""),
            f"{report.seconds:.1f} s",
            plural(report.steps, "step"),
        ]
        self._say(_text(f" {self._dot} ".join(facts), "bright_black"), 2)
        if missing := report.sandbox.missing:
            self._say(
                _text(f"missing protections on this machine: {one_line('; '.join(missing))}", _WARNING), 2, hang=2
            )
        for reason, group in groupby(report.checks, lambda check: check.verdict is Verdict.SKIP and check.reason):
            checks = list(group)
            if reason and len(checks) > 1:
                self._skipped(checks)
            else:
                for check in checks:
                    self._check(check, report.file)
        self._say(_text())

    def _skipped(self, checks: list[CheckReport]) -> None:
        """Print checks that were skipped for one reason as one paragraph."""
        names = ", ".join(check.check for check in checks)
        sign = SIGNS[Verdict.SKIP] if self._signs else f"{Verdict.SKIP:<5}"
        self._say(_text(f"{sign} {names}: {one_line(checks[0].reason)}", STYLES[Verdict.SKIP]), 2, hang=2)

    def _check(self, check: CheckReport, path: str) -> None:
        style = STYLES[check.verdict]
        line = _text()
        line.append(SIGNS[check.verdict] if self._signs else f"{check.verdict:<5}", style).append(" ")
        line.append(f"{check.check:<12}", "" if check.verdict is not Verdict.SKIP else style)
        line.append(f"{check.seconds:6.2f} s", "bright_black")
        if check.reason:
            line.append("  ").append(one_line(check.reason), style)
        self._say(line, 2, hang=len(line.plain) - len(one_line(check.reason)) if check.reason else 0)
        for finding in check.findings:
            self._findings += 1
            self._finding(finding, path)
        for ignored in check.ignored:
            reason = one_line(ignored.reason) or "no reason is given"
            words = f"{ignored.finding.code} ignored by line {ignored.line}: {reason}"
            self._say(_text(words, "bright_black"), 4, hang=2)

    def _finding(self, finding: Finding, path: str) -> None:
        style = "red" if finding.severity is Severity.ERROR else _WARNING
        rule = self.rules.get(finding.code)
        head = _text()
        head.append(finding.code, f"bold {style}").append(" ")
        if rule is not None:
            head.append(rule.name, style).append(" ")
        if finding.severity is Severity.WARNING:
            head.append("(warning) ", style)
        head.append(one_line(path) + (f":{finding.line}" if finding.line else ""), "cyan")
        self._say(head, 4)
        self._say(_text(one_line(finding.message)), 6)
        if rule is not None:
            self._say(_text().append("fix: ", "green").append(rule.fix), 6, hang=5)
        for line in printed(finding):
            self._say(_text().append("printed: ", "bright_black").append(line), 6, hang=9)
        self._say(_text(f"#{self._findings}: {repro_words(finding.repro)}", "bright_black"), 6, hang=4)

    def _summary(self, report: Report) -> None:
        verdicts = Counter(subject.verdict for subject in report.reports)
        findings = [finding for subject in report.reports for check in subject.checks for finding in check.findings]
        errors = sum(finding.severity is Severity.ERROR for finding in findings)
        line = _text()
        for verdict, word in zip(Verdict, ("passed", "failed", "skipped", "could not be judged"), strict=True):
            if verdicts[verdict]:
                line.append(", " if line.plain else "").append(f"{verdicts[verdict]} {word}", f"bold {STYLES[verdict]}")
        if not line.plain:
            line.append("nothing judged")
        line.append(
            f" {self._dot} {plural(errors, 'finding')}, "
            f"{plural(len(findings) - errors, 'warning')} {self._dot} contract {report.contract}, "
            f"budget {report.budget}, seed {report.seed}"
        )
        if ignored := sum(len(check.ignored) for subject in report.reports for check in subject.checks):
            line.append(f" {self._dot} {ignored:,} ignored by comments")
        if changed := [f"{name} {value}" for name, value in report.severity.items()]:
            line.append(f" {self._dot} severity {one_line(', '.join(changed))}")
        if report.strict:
            line.append(f" {self._dot} strict")
        self._say(line)
        if findings:
            how = "Show finding #K again: add --format json --output report.json, then envcraft replay report.json "
            self._say(_text(how + "--finding K. Read about a rule: envcraft explain CODE.", "bright_black"))

    @property
    def _dot(self) -> str:
        return "·" if self._signs else "-"

    def _say(self, text: Text, indent: int = 0, hang: int = 0) -> None:
        """Print a paragraph; on a terminal wrap it with `indent`, and further lines with `hang` more."""
        console = self._console
        if not self._signs:
            # Replace character by character, so that styles keep their places.
            text.plain = text.plain.encode(console.encoding, "replace").decode(console.encoding)
        if not console.is_terminal:
            console.print(_text(" " * indent) + text, soft_wrap=True)
            return
        # A hanging indent must leave room for text.
        hang = hang if indent + hang < console.width // 2 else 2
        lines = text.wrap(console, max(console.width - indent, 20)) or [text]
        if len(lines) > 1:
            after = text.plain[len(lines[0].plain) :]
            rest = text[len(text.plain) - len(after.lstrip()) :]
            lines = [lines[0], *rest.wrap(console, max(console.width - indent - hang, 20))]
        for number, line in enumerate(lines):
            line.rstrip()
            console.print(_text(" " * (indent + hang * bool(number))) + line, soft_wrap=True)


def printed(finding: Finding) -> list[str]:
    """Return the last lines that the code printed before the finding; the JSON report has more."""
    lines = [line for line in str(finding.evidence.get("output", "")).splitlines() if line.strip()]
    return [one_line(line)[:_PRINTED_WIDTH] for line in lines[-_PRINTED_LINES:]]


def _text(words: str = "", style: str = "") -> Text:
    from rich.text import Text

    return Text(words, style)


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [ConsoleReporter]
