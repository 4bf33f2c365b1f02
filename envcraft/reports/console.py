"""The report for people: a block for each finished subject, and a summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, TextIO

from envcraft.model.events import Event, Finished, SubjectFinished, SubjectStarted
from envcraft.model.verdict import CheckReport, Finding, Outcome, Report, Severity, SubjectReport
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import EvidenceLine, Rank, evidence_lines, most_important, place_of, source_line
from envcraft.reports.pictures import picture_lines, shows_pictures
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import counted, reason_words, repro_words, uncounted
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text

    from envcraft.judging.check import Rule

STYLES = {
    Outcome.PASS: "green",
    Outcome.FAIL: "red",
    Outcome.UNDECIDED: "yellow",
    Outcome.SKIP: "bright_black",
    Outcome.ERROR: "magenta",
}
_BADGES = {outcome: f"bold white on {style}" for outcome, style in STYLES.items()}
SIGNS = {Outcome.PASS: "✓", Outcome.FAIL: "✗", Outcome.UNDECIDED: "?", Outcome.SKIP: "-", Outcome.ERROR: "!"}
_WARNING = "yellow"
#: The most lines of one finding, unless all evidence is shown.
_LINES = 12
#: The least and the most lines of a picture, and the most of one if all evidence is shown.
_PICTURE, _LARGE_PICTURE = (3, 6), 20


class ConsoleReporter(Reporter):
    """Print colours and wrapped text on a terminal, plain unwrapped text elsewhere.

    Attributes:
        again: how the reader shows a finding again; "" for a reader without the command that made the report.
    """

    name = "console"
    again = (
        "Show finding #K again: add --format json --output report.json, then envcraft replay report.json --finding K. "
    )
    summary = "for people: a block for each environment (default)"

    def __init__(self, output: TextIO, rules: Mapping[str, Rule], console: Console | None = None) -> None:
        super().__init__(output, rules)
        self._given = console
        self.wants_frames = shows_pictures(output)
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
        if self.verbosity < 0 and report.outcome is Outcome.PASS:
            self._findings += sum(len(check.findings) for check in report.checks)
            return
        title = _text()
        title.append(f" {report.outcome.upper():<5}", _BADGES[report.outcome])
        title.append("  ").append(one_line(report.path), "bold")
        self._say(title)
        facts = [
            one_line(".".join(filter(None, [report.module, report.env_class]))) if report.env_class else "no class",
            f"{report.isolation} isolation" + (f" by {report.driver}" if report.driver != report.isolation else ""),
            f"{report.seconds:.1f} s",
            plural(report.steps, "step"),
        ]
        self._say(_text(f" {self._dot} ".join(facts), "bright_black"), 2)
        if missing := report.sandbox.missing:
            self._say(
                _text(f"missing protections on this machine: {one_line('; '.join(missing))}", _WARNING), 2, hang=2
            )
        for (outcome, reason), group in groupby(report.checks, lambda check: (check.outcome, check.reason)):
            checks = list(group)
            if outcome in (Outcome.SKIP, Outcome.UNDECIDED) and reason and len(checks) > 1:
                self._skipped(checks)
            else:
                for check in checks:
                    self._check(check, report)
        self._say(_text())

    def _skipped(self, checks: list[CheckReport]) -> None:
        """Print checks that were skipped for one reason as one paragraph."""
        names = ", ".join(check.check for check in checks)
        outcome = checks[0].outcome
        sign = SIGNS[outcome] if self._signs else f"{outcome:<5}"
        self._say(_text(f"{sign} {names}: {reason_words(checks[0])}", STYLES[outcome]), 2, hang=2)

    def _check(self, check: CheckReport, subject: SubjectReport) -> None:
        style = STYLES[check.outcome]
        line = _text()
        line.append(SIGNS[check.outcome] if self._signs else f"{check.outcome:<5}", style).append(" ")
        line.append(f"{check.check:<12}", style if check.outcome is Outcome.SKIP else "")
        line.append(f"{check.seconds:6.2f} s", "bright_black")
        reason = reason_words(check)
        if reason:
            line.append("  ").append(reason, style)
        self._say(line, 2, hang=len(line.plain) - len(reason) if reason else 0)
        for finding in check.findings:
            self._findings += 1
            self._finding(finding, subject)
        for ignored in check.ignored:
            reason = one_line(ignored.reason) or "no reason is given"
            words = f"{ignored.finding.code} ignored by line {ignored.line}: {reason}"
            self._say(_text(words, "bright_black"), 4, hang=2)

    def _finding(self, finding: Finding, subject: SubjectReport) -> None:
        style = "red" if finding.severity is Severity.ERROR else _WARNING
        rule = self.rules.get(finding.code)
        head = _text()
        head.append(finding.code, f"bold {style}").append(" ")
        if rule is not None:
            head.append(rule.name, style).append(" ")
        if finding.severity is Severity.WARNING:
            head.append("(warning) ", style)
        head.append(one_line(place_of(subject, finding)), "cyan")
        place = self._lines(head, 4)
        message = self._lines(_text(one_line(finding.message)), 6)
        # Without its indentation, which would push the fault out of a narrow terminal.
        code = source_line(subject, finding).lstrip()
        source = self._lines(_text(f"{finding.line} | ", "bright_black").append(code), 6, cut=True) if code else []
        fix = self._lines(_text().append("fix: ", "green").append(rule.fix), 6, hang=5) if rule is not None else []
        again = self._lines(_text(f"#{self._findings}: {repro_words(finding.repro)}", "bright_black"), 6, hang=4)
        evidence = evidence_lines(finding, self.verbosity > 0)
        shown = self._evidence(evidence)
        if self.verbosity <= 0:
            # Long sentences give way to the evidence that matters most, and to the line that counts the rest.
            vital = sum(line.rank >= Rank.RAISED for line in evidence)
            room = _LINES - len(place) - len(source) - min(len(shown), vital + 1)
            self._shorten([again, fix, message], room)
        before, after = [*place, *message, *source], [*fix, *again]
        room = max(_LINES - len(before) - len(after), 0)
        if self.verbosity <= 0 and len(shown) > room:
            kept = most_important(evidence, max(room - 1, 0))
            more = plural(len(evidence) - len(kept), "more line")
            # As short as a narrow terminal needs it. A message may fill the room, and the reader must still know.
            words = f"--verbose shows {more}" if self.again else f"{more} of evidence"
            shown = self._evidence(kept) + self._lines(_text(words, "bright_black"), 6, cut=True)
        picture = self._picture(subject, finding, room - len(shown))
        for line in [*before, *shown, *picture, *after]:
            self._console.print(line, soft_wrap=True)

    def _evidence(self, lines: list[EvidenceLine]) -> list[Text]:
        return [
            line
            for label, words, _ in lines
            for line in self._lines(_text(f"{label}: " if label else "", "bright_black").append(words), 6, cut=True)
        ]

    def _shorten(self, paragraphs: list[list[Text]], room: int) -> None:
        """Cut paragraphs to `room` lines in all, the first ones first; each keeps a line, and shows where it is cut."""
        ellipsis = "…" if self._signs else "..."
        for lines in paragraphs:
            excess = sum(map(len, paragraphs)) - room
            if excess > 0 and len(lines) > 1:
                del lines[max(len(lines) - excess, 1) :]
                lines[-1].truncate(self._console.width - len(ellipsis))
                lines[-1].append(ellipsis)

    def _picture(self, subject: SubjectReport, finding: Finding, room: int) -> list[Text]:
        """Draw the observation that differs and the expected one, in at most `room` lines."""
        least, most = _PICTURE
        most = _LARGE_PICTURE if self.verbosity > 0 else min(room, most)
        if self.frames is None or finding.evidence.get("field") != "observation" or most < least:
            return []
        frames = self.frames(subject, finding)
        drawn = picture_lines(frames[-1], most, self._console.width - 6) if frames else []
        return [_text(" " * 6) + line for line in drawn]

    def _summary(self, report: Report) -> None:
        outcomes = Counter(subject.outcome for subject in report.reports)
        findings = [finding for subject in report.reports for check in subject.checks for finding in check.findings]
        errors = sum(finding.severity is Severity.ERROR for finding in findings)
        line = _text()
        for outcome, words in counted(outcomes):
            style = f"bold {STYLES[outcome]}" if outcomes[outcome] else "bright_black"
            line.append(", " if line.plain else "").append(words, style)
        if not line.plain:
            line.append("nothing judged")
        line.append(
            f" {self._dot} {plural(errors, 'finding')}, "
            f"{plural(len(findings) - errors, 'warning')} {self._dot} contract {report.contract}, "
            f"budget {report.budget}, seed {report.seed}"
        )
        for words in uncounted(report):
            line.append(f" {self._dot} {words}")
        if changed := [f"{name} {value}" for name, value in report.severity.items()]:
            line.append(f" {self._dot} severity {one_line(', '.join(changed))}")
        if report.strict:
            line.append(f" {self._dot} strict")
        self._say(line)
        if late := sum(subject.out_of_time for subject in report.reports):
            words = "undecided checks have not passed; a longer --time-limit may settle them"
            self._say(_text(f"{plural(late, 'environment')} ran out of time: {words}", _WARNING))
        if findings and self.verbosity >= 0:
            self._say(_text(f"{self.again}Read about a rule: envcraft explain CODE.", "bright_black"))

    @property
    def _dot(self) -> str:
        return "·" if self._signs else "-"

    def _say(self, text: Text, indent: int = 0, hang: int = 0) -> None:
        """Print a paragraph; on a terminal wrap it with `indent`, and further lines with `hang` more."""
        for line in self._lines(text, indent, hang):
            self._console.print(line, soft_wrap=True)

    def _lines(self, text: Text, indent: int = 0, hang: int = 0, cut: bool = False) -> list[Text]:
        """Lay out a paragraph as :meth:`_say` prints it; with `cut` as one line, which ends at the terminal's edge."""
        console = self._console
        if not self._signs:
            # Replace character by character, so that styles keep their places.
            text.plain = text.plain.encode(console.encoding, "replace").decode(console.encoding)
        if not console.is_terminal:
            return [_text(" " * indent) + text]
        if cut and self.verbosity <= 0:
            text.truncate(max(console.width - indent, 20), overflow="ellipsis" if self._signs else "crop")
            return [_text(" " * indent) + text]
        # A hanging indent must leave room for text.
        hang = hang if indent + hang < console.width // 2 else 2
        lines = text.wrap(console, max(console.width - indent, 20)) or [text]
        if len(lines) > 1:
            after = text.plain[len(lines[0].plain) :]
            rest = text[len(text.plain) - len(after.lstrip()) :]
            lines = [lines[0], *rest.wrap(console, max(console.width - indent - hang, 20))]
        for line in lines:
            line.rstrip()
        return [_text(" " * (indent + hang * bool(number))) + line for number, line in enumerate(lines)]


def _text(words: str = "", style: str = "") -> Text:
    from rich.text import Text

    return Text(words, style)


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [ConsoleReporter]
