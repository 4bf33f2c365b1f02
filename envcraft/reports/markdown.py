"""The report as GitHub-flavoured Markdown, for a comment on a pull request."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

from envcraft.model.events import Event, Finished
from envcraft.model.verdict import CheckReport, Outcome, Report, Severity, SubjectReport, Verdict, plain
from envcraft.plugins import hookimpl
from envcraft.reports.evidence import place_of
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import Numbered, numbered, replay_command, repro_words, summary_words, unsettled
from envcraft.text import one_line, printable

#: GitHub refuses comments of more than 65,536 characters; the rest is for a line of the caller.
LIMIT = 65_000
#: Characters for the table: findings matter more than the names of passing environments.
_TABLE = LIMIT // 3
#: Characters of one field: a message is a sentence, a traceback a page.
_WORDS, _BLOCK = 1_000, 4_000
_SIGNS = {
    Outcome.PASS: "✅",
    Outcome.FAIL: "❌",
    Outcome.UNDECIDED: "❔",
    Outcome.SKIP: "⏭️",
    Outcome.ERROR: "⚠️",
}
#: Worst first.
_ORDER = (Outcome.FAIL, Outcome.ERROR, Outcome.UNDECIDED, Outcome.SKIP, Outcome.PASS)
#: Characters with a meaning in Markdown or HTML.
_SPECIAL = re.compile(r"[&<>\"'`*_\[\]|~\\#$!]")
#: GitHub turns these into mentions, references or links; a zero-width space prevents it.
_LINKED = re.compile(r"(?=@)|@|#(?=\w)|\bGH-(?=\d)|:(?=//)|\bwww\.", re.IGNORECASE)
_GAP = "\u200b"


class MarkdownReporter(Reporter):
    """Write a sentence, a table of the environments and folded findings, never longer than a comment may be."""

    name = "markdown"
    summary = "Markdown, for a comment on a pull request"
    suffix = ".md"

    def handle(self, event: Event) -> None:
        if isinstance(event, Finished):
            self.write(self._comment(event.report))

    def _comment(self, report: Report) -> str:
        outcomes = {subject.outcome for subject in report.reports}
        worst = next((outcome for outcome in _ORDER if outcome in outcomes), Outcome.SKIP)
        head = f"### {_SIGNS[worst]} EnvCraft: {_text(summary_words(report))}\n\n{_table(report)}\n"
        foot = (
            f"<sub>EnvCraft {_text(report.envcraft)}, contract {_text(report.contract)}, "
            f"budget {_text(report.budget)}, seed {report.seed}. "
            "To read about a rule: <code>envcraft explain CODE</code></sub>\n"
        )
        # The note about omitted sections must fit, too.
        room = LIMIT - len(head) - len(foot) - 250
        sections = [section for _, section in sorted(self._sections(report), key=lambda ranked: ranked[0])]
        kept = 0
        while kept < len(sections) and len(sections[kept]) <= room:
            room -= len(sections[kept])
            kept += 1
        note = (
            f"**{len(sections) - kept:,} more findings and errors are left out**: a comment has no room for them. "
            "The formats json, html and sarif contain everything.\n\n"
            if kept < len(sections)
            else ""
        )
        return head + "".join(sections[:kept]) + note + foot

    def _sections(self, report: Report) -> Iterator[tuple[int, str]]:
        """Yield a folded paragraph with its rank for each finding and each check that could not judge."""
        for item in numbered(report):
            rank = 0 if item.finding.severity is Severity.ERROR else 2
            yield rank, self._finding(report, item)
        for subject in report.reports:
            for check in _lost(subject):
                yield 1, _folded(f"{_SIGNS[Outcome.ERROR]} {_text(check.check)} {_code(subject.path)}", check.reason)

    def _finding(self, report: Report, item: Numbered) -> str:
        finding, rule = item.finding, self.rules.get(item.finding.code)
        sign = _SIGNS[Outcome.FAIL] if finding.severity is Severity.ERROR else "🔸"
        name = f" {_text(rule.name)}" if rule else ""
        title = f"{sign} <b>{_text(finding.code)}</b>{name} {_code(place_of(item.subject, finding))}"
        parts = [f"**Rule:** {_prose(rule.summary)}\n\n**Fix:** {_prose(rule.fix)}\n\n"] if rule else []
        if evidence := {key: value for key, value in finding.evidence.items() if value is not None}:
            parts.append(_block("\n".join(f"{one_line(key)}: {_value(value)}" for key, value in evidence.items())))
        parts.append(f"**Reproduction:** {_text(repro_words(finding.repro))}\n\n")
        parts.append(_block(replay_command(report, item), "sh"))
        return _folded(title, finding.message, "".join(parts))


def _table(report: Report) -> str:
    """List the environments, worst first, as far as there is room."""
    lines = ["| | environment | findings | steps | time |\n|---|---|---|--:|--:|\n"]
    ranked = sorted(report.reports, key=lambda subject: _ORDER.index(subject.outcome))
    room = _TABLE
    for number, subject in enumerate(ranked):
        codes = Counter(finding.code for check in subject.checks for finding in check.findings)
        words = [code if count == 1 else f"{code} ({count:,})" for code, count in codes.items()]
        words += [f"{check.check} could not judge" for check in _lost(subject)]
        words += [f"{name} undecided" for name in [*subject.undecided, *(check.check for check in unsettled(subject))]]
        cells = (
            _SIGNS[subject.outcome],
            _code(subject.path),
            _text(", ".join(words), 300),
            f"{subject.steps:,}",
            f"{subject.seconds:.1f} s",
        )
        row = f"| {' | '.join(cells)} |\n"
        room -= len(row)
        if room < 0:
            left = Counter(other.outcome for other in ranked[number:])
            counts = ", ".join(f"{count:,} {_SIGNS[outcome]}" for outcome, count in left.items())
            lines.append(f"| | and {left.total():,} more | {counts} | | |\n")
            break
        lines.append(row)
    return "".join(lines)


def _lost(subject: SubjectReport) -> list[CheckReport]:
    """Return the checks that could not judge, or a placeholder if the subject was lost before any check."""
    broken = [check for check in subject.checks if check.verdict is Verdict.ERROR]
    if not broken and subject.verdict is Verdict.ERROR:
        return [CheckReport("everything", Verdict.ERROR, reason=subject.reason)]
    return broken


def _folded(title: str, message: str, details: str = "") -> str:
    words = _text(message) or "no message"
    return f"<details><summary>{title}<br>{words}</summary>\n\n{details}</details>\n\n"


def _text(words: str, most: int = _WORDS) -> str:
    """Escape text for Markdown and HTML: one line without markup, links, mentions and references."""
    return _escape(_cut(one_line(words), most))


def _prose(words: str) -> str:
    """Escape the text of a rule, in which backticks mark code."""
    parts = one_line(words).split("`")
    return "".join(_code(part) if index % 2 else _escape(part) for index, part in enumerate(parts))


def _escape(line: str) -> str:
    line = _LINKED.sub(lambda found: found[0] + _GAP, line)
    escaped = _SPECIAL.sub(lambda found: f"&#{ord(found[0])};", line)
    # GitHub matches these in the source.
    return re.sub(r"\bwww\.", lambda found: found[0][:-1] + "&#46;", escaped, flags=re.IGNORECASE)


def _code(words: str) -> str:
    """Format text as code; inside HTML, backticks do not work."""
    return f"<code>{_text(words, 200)}</code>"


def _block(words: str, language: str = "") -> str:
    """Format a code block with a fence that is longer than any in it."""
    words = _cut(printable(words), _BLOCK)
    fence = "`" * max([3, *(len(run) + 1 for run in re.findall("`+", words))])
    return f"{fence}{language}\n{words}\n{fence}\n\n"


def _value(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(plain(value))
    return f"\n{text.rstrip()}" if "\n" in text else text


def _cut(words: str, most: int) -> str:
    return words if len(words) <= most else f"{words[: most - 1]}…"


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [MarkdownReporter]
