"""The report for people: a block for each subject as it ends, and a summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Any, TextIO

from rich.console import Console
from rich.text import Text

from envcraft.events import Event, Finished, SubjectFinished
from envcraft.plugins import hookimpl
from envcraft.reports import Reporter, one_line, plural
from envcraft.verdict import CheckReport, Finding, Report, Repro, Severity, SubjectReport, Verdict

if TYPE_CHECKING:
    from envcraft.check import Rule

_STYLES = {Verdict.PASS: "green", Verdict.FAIL: "red", Verdict.SKIP: "bright_black", Verdict.ERROR: "magenta"}
_BADGES = {verdict: f"bold white on {style}" for verdict, style in _STYLES.items()}
_SIGNS = {Verdict.PASS: "✓", Verdict.FAIL: "✗", Verdict.SKIP: "-", Verdict.ERROR: "!"}
_WARNING = "yellow"
#: Conditions of a reproduction whose field names say too little.
_CONDITIONS = {
    "before": "after other episodes",
    "companion": "beside another instance",
    "again": "played twice",
    "clock": "another clock",
    "fresh": "fresh worker",
    "render": "with render() in between",
}


class ConsoleReporter(Reporter):
    """Colours on a terminal, plain text elsewhere, one line a sentence where nothing needs wrapping."""

    name = "console"
    summary = "for people: a block for each environment (default)"

    def __init__(self, output: TextIO, rules: Mapping[str, Rule], console: Console | None = None) -> None:
        super().__init__(output, rules)
        self._console = console or Console(file=output, highlight=False, markup=False, emoji=False)
        self._signs = self._console.encoding.lower().startswith("utf")
        self._findings = 0

    def handle(self, event: Event) -> None:
        if isinstance(event, SubjectFinished):
            self._subject(event.report)
        elif isinstance(event, Finished):
            self._summary(event.report)

    def _subject(self, report: SubjectReport) -> None:
        title = Text()
        title.append(f" {report.verdict.upper():<5}", _BADGES[report.verdict])
        title.append("  ").append(one_line(report.path), "bold")
        self._say(title)
        facts = [
            one_line(report.env_class) if report.env_class else "no class",
            f"{report.isolation} isolation" + (f" by {report.driver}" if report.driver != report.isolation else ""),
            f"{report.seconds:.1f} s",
            plural(report.steps, "step"),
        ]
        self._say(Text(f" {self._dot} ".join(facts), "bright_black"), 2)
        for reason, group in groupby(report.checks, lambda check: check.verdict is Verdict.SKIP and check.reason):
            checks = list(group)
            if reason and len(checks) > 1:
                self._skipped(checks)
            else:
                for check in checks:
                    self._check(check, report.path)
        self._say(Text())

    def _skipped(self, checks: list[CheckReport]) -> None:
        """Checks skipped for the same reason, in one paragraph."""
        names = ", ".join(check.check for check in checks)
        sign = _SIGNS[Verdict.SKIP] if self._signs else f"{Verdict.SKIP:<5}"
        self._say(Text(f"{sign} {names}: {one_line(checks[0].reason)}", _STYLES[Verdict.SKIP]), 2, hang=2)

    def _check(self, check: CheckReport, path: str) -> None:
        style = _STYLES[check.verdict]
        line = Text()
        line.append(_SIGNS[check.verdict] if self._signs else f"{check.verdict:<5}", style).append(" ")
        line.append(f"{check.check:<12}", "" if check.verdict is not Verdict.SKIP else style)
        line.append(f"{check.seconds:6.2f} s", "bright_black")
        if check.reason:
            line.append("  ").append(one_line(check.reason), style)
        self._say(line, 2, hang=len(line.plain) - len(one_line(check.reason)) if check.reason else 0)
        for finding in check.findings:
            self._findings += 1
            self._finding(finding, path)

    def _finding(self, finding: Finding, path: str) -> None:
        style = "red" if finding.severity is Severity.ERROR else _WARNING
        rule = self.rules.get(finding.code)
        head = Text()
        head.append(finding.code, f"bold {style}").append(" ")
        if rule is not None:
            head.append(rule.name, style).append(" ")
        if finding.severity is Severity.WARNING:
            head.append("(warning) ", style)
        head.append(one_line(path) + (f":{finding.line}" if finding.line else ""), "cyan")
        self._say(head, 4)
        self._say(Text(one_line(finding.message)), 6)
        if rule is not None:
            self._say(Text.assemble(("fix: ", "green"), rule.fix), 6, hang=5)
        self._say(Text(f"#{self._findings}: {repro_words(finding.repro)}", "bright_black"), 6, hang=4)

    def _summary(self, report: Report) -> None:
        verdicts = Counter(subject.verdict for subject in report.reports)
        findings = [finding for subject in report.reports for check in subject.checks for finding in check.findings]
        errors = sum(finding.severity is Severity.ERROR for finding in findings)
        line = Text()
        for verdict, word in zip(Verdict, ("passed", "failed", "skipped", "could not be judged"), strict=True):
            if verdicts[verdict]:
                line.append(", " if line.plain else "").append(
                    f"{verdicts[verdict]} {word}", f"bold {_STYLES[verdict]}"
                )
        line.append(
            f"{f' {self._dot} ' if line.plain else ''}{plural(errors, 'finding')}, "
            f"{plural(len(findings) - errors, 'warning')} {self._dot} contract {report.contract}, "
            f"budget {report.budget}, seed {report.seed}"
        )
        self._say(line)
        if findings:
            how = "To see finding #K again: add --format json --output report.json, then envcraft replay report.json "
            self._say(Text(how + "--finding K. To read about a rule: envcraft explain CODE.", "bright_black"))

    @property
    def _dot(self) -> str:
        return "·" if self._signs else "-"

    def _say(self, text: Text, indent: int = 0, hang: int = 0) -> None:
        """Print a paragraph, on a terminal wrapped with its indent (and further lines `hang` more)."""
        console = self._console
        if not console.is_terminal:
            console.print(Text(" " * indent) + text, soft_wrap=True)
            return
        # A hang that leaves no room is worse than none.
        hang = hang if indent + hang < console.width // 2 else 2
        lines = text.wrap(console, max(console.width - indent, 20)) or [text]
        if len(lines) > 1:
            after = text.plain[len(lines[0].plain) :]
            rest = text[len(text.plain) - len(after.lstrip()) :]
            lines = [lines[0], *rest.wrap(console, max(console.width - indent - hang, 20))]
        for number, line in enumerate(lines):
            line.rstrip()
            console.print(Text(" " * (indent + hang * bool(number))) + line, soft_wrap=True)


def repro_words(repro: Repro) -> str:
    """A reproduction in a few words: ``seed 0, 41 actions, hash_seed 1``."""
    parts = [f"seed {repro.seed}", plural(len(repro.actions), "action") if repro.actions else "no action"]
    parts += [f"{_CONDITIONS.get(name, name)} {_condition(value)}".strip() for name, value in repro.conditions.items()]
    return one_line(", ".join(parts))


def _condition(value: Any) -> str:
    if value is True or isinstance(value, dict | list):
        return ""
    return str(value)


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [ConsoleReporter]
