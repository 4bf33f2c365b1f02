"""The data that the list of environments loads in chunks: rows of the list, and details of each environment.

Each chunk is a script that calls ``envcraft(kind, number, data)``, because a page that is opened as a file can load
nothing but scripts.
"""

from __future__ import annotations

import json
from collections.abc import Hashable
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

from envcraft.corpus.report.data import Entry
from envcraft.judging.check import Rule
from envcraft.model.verdict import CheckReport, Finding, plain
from envcraft.reports.summary import repro_words
from envcraft.text import one_line, printable

#: The rows of a chunk, and the size in bytes after which a chunk of details ends.
ROWS, DETAIL = 500, 192 * 1024
#: The characters of a source, and of one piece of evidence, that are shown.
_SOURCE, _EVIDENCE = 400_000, 4_000


_Word = TypeVar("_Word", bound=Hashable)


class Legend(Generic[_Word]):
    """Numbers for what occurs in many rows."""

    def __init__(self) -> None:
        self.words: list[_Word] = []
        self._numbers: dict[_Word, int] = {}

    def number(self, word: _Word) -> int:
        if word not in self._numbers:
            self._numbers[word] = len(self.words)
            self.words.append(word)
        return self._numbers[word]


class Chunks:
    """Writes the chunks below a folder. Call :meth:`end` after the last environment.

    Attributes:
        verdicts: of environments.
        codes: of findings.
        ways: the outcomes of all checks on an environment, as pairs of a check and its outcome.
    """

    def __init__(self, folder: Path, rules: dict[str, Rule]) -> None:
        self._folder = folder
        self._rules = rules
        self.verdicts: Legend[str] = Legend()
        self.codes: Legend[str] = Legend()
        self.ways: Legend[tuple[tuple[str, str], ...]] = Legend()
        self._rows: list[list[Any]] = []
        self._details: list[bytes] = []
        self._size = 0
        self.rows = self.details = 0
        folder.mkdir()

    def add(
        self, entry: Entry, source: bytes, lines: int, preview: bool, facets: list[list[int]], more: dict[str, Any]
    ) -> None:
        """Add an environment.

        Args:
            entry: the environment.
            source: its source.
            lines: how many lines its source has.
            preview: whether it has a preview.
            facets: the numbers of its values by facet.
            more: further fields of its details, whose text is printable.
        """
        report = entry.report
        checks = [] if report is None else report.checks
        way = tuple((one_line(check.check), check.outcome.value) for check in checks)
        # All text in it is printable and can be encoded.
        detail = msgspec.json.encode({**self._detail(entry, checks, source), **more})
        if self._details and self._size + len(detail) > DETAIL:
            self._write_details()
        self._details.append(detail)
        self._size += len(detail)
        self._rows.append(
            [
                one_line(entry.name),
                self.verdicts.number(entry.outcome),
                self.ways.number(way),
                [self.codes.number(code) for code in entry.codes],
                0 if report is None else report.steps,
                0 if report is None else round(report.seconds, 2),
                lines,
                int(preview),
                self.details,
                facets,
            ]
        )
        if len(self._rows) == ROWS:
            self._write_rows()

    def end(self) -> None:
        """Write the last chunks."""
        if self._rows:
            self._write_rows()
        if self._details:
            self._write_details()

    def _detail(self, entry: Entry, checks: list[CheckReport], source: bytes) -> dict[str, Any]:
        text = source.decode("utf-8", "replace")
        return {
            "number": entry.number,
            "name": one_line(entry.name),
            "class": one_line(entry.report.env_class if entry.report and entry.report.env_class else ""),
            "sha256": entry.environment.source,
            "added": entry.added,
            "origin": [[one_line(key), one_line(_value(value))[:_EVIDENCE]] for key, value in entry.origin.items()],
            "reason": one_line(entry.report.reason) if entry.report else "",
            "isolation": entry.report.isolation if entry.report else "",
            "checks": [[one_line(c.check), c.outcome.value, c.seconds, one_line(c.reason)] for c in checks],
            "findings": [self._finding(check, finding) for check in checks for finding in check.findings],
            "source": printable(text[:_SOURCE]),
            "cut": len(text) > _SOURCE,
        }

    def _finding(self, check: CheckReport, finding: Finding) -> dict[str, Any]:
        rule = self._rules.get(finding.code)
        return {
            "check": one_line(check.check),
            "code": one_line(finding.code),
            "name": rule.name if rule else "",
            "fix": rule.fix if rule else "",
            "severity": finding.severity.value,
            "message": one_line(finding.message),
            "line": finding.line,
            "evidence": [
                [one_line(key), printable(_value(value))[:_EVIDENCE]]
                for key, value in finding.evidence.items()
                if value is not None
            ],
            "repro": repro_words(finding.repro),
        }

    def _write_rows(self) -> None:
        self._write("rows", self.rows, msgspec.json.encode(self._rows))
        self.rows, self._rows = self.rows + 1, []

    def _write_details(self) -> None:
        self._write("about", self.details, b"[" + b",\n".join(self._details) + b"]")
        self.details, self._details, self._size = self.details + 1, [], 0

    def _write(self, kind: str, number: int, data: bytes) -> None:
        (self._folder / f"{kind}-{number}.js").write_bytes(b'envcraft("%s",%d,%s);\n' % (kind.encode(), number, data))


def _value(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(plain(value))
