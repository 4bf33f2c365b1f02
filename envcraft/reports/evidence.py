"""What a finding is shown with: the line of the file, the values that differ, the traceback, and what was printed."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import re
from collections.abc import Iterator, Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Any, NamedTuple

from envcraft.model.target import Kind, read_known
from envcraft.model.verdict import Finding, SubjectReport, plain
from envcraft.text import one_line, printable, relative

_WIDTH = 200
#: The most lines of a traceback, and of what was printed: the last ones.
_TRACEBACK, _PRINTED = 6, 3
_FRAME = re.compile(r' *File "(.*)", line \d+')
#: What Python writes below the part of a line that raised.
_MARKS = re.compile(r" *[~^]+ *")
#: Evidence that is shown in a form of its own, or that the message or the reproduction has already.
_APART = {"traceback", "output", "first", "second", "field", "step", "cell"}
#: The last sources that are no whole files, by digest, with the first lines of their cells, and how many are kept.
_kept: dict[str, tuple[bytes, Mapping[str, int]]] = {}
_KEPT = 64


class Rank(IntEnum):
    """How long a line of evidence is kept where not all have room."""

    OTHER = 0
    MARKS = 1
    PLACE = 2
    OWN_PLACE = 3
    PRINTED = 4
    RAISED = 5
    OWN = 6
    VALUE = 7


class EvidenceLine(NamedTuple):
    """A line of evidence with its label, "" for one of a traceback."""

    label: str
    words: str
    rank: Rank = Rank.OTHER


def keep_source(source: bytes, cells: Mapping[str, int] = MappingProxyType({})) -> None:
    """Let findings about a text, or about a part of a script or notebook, show its lines in this process.

    Args:
        source: the text.
        cells: the first line of each cell of a notebook by name.
    """
    _kept[hashlib.sha256(source).hexdigest()] = source, cells
    while len(_kept) > _KEPT:
        del _kept[next(iter(_kept))]


def place_of(report: SubjectReport, finding: Finding) -> str:
    """Return the file that a finding is about, with its line, or the cell of a notebook with its line."""
    if not finding.line:
        raising = raising_place(report, finding)
        return report.file if raising is None else f"{raising[0]}:{raising[1]}"
    cell = finding.evidence.get("cell")
    return f"{report.file}:{finding.line}" if cell is None else f"{cell}, line {finding.line}"


def raising_place(report: SubjectReport, finding: Finding) -> tuple[str, int] | None:
    """Return another file of the project that raises what a finding reports, and the line; None if no other does."""
    file, line, project = finding.evidence.get("file"), finding.evidence.get("file_line"), report.project
    if project is None or not isinstance(file, str) or file not in project.files or type(line) is not int or line < 1:
        return None
    return relative(os.path.join(project.root, file)), line


def source_line(report: SubjectReport, finding: Finding) -> str:
    """Return the line of the source that a finding names, or "" if there is none or the file has changed since.

    The file is read as text and not run.
    """
    if finding.line is None or finding.line < 1:
        return ""
    lines = source_of(report).decode("utf-8", "replace").splitlines()
    _, cells = _kept.get(report.source_sha256, (b"", {}))
    number = cells.get(str(finding.evidence.get("cell")), 1) + finding.line - 1
    return _cut(lines[number - 1]).rstrip() if number <= len(lines) else ""


def source_of(report: SubjectReport) -> bytes:
    """Return the source that a report is about; b"" if it cannot be read or has changed since."""
    if kept := _kept.get(report.source_sha256):
        return kept[0]
    path = report.path if report.kind is Kind.SOURCE else report.source_file
    return read_known(path, report.source_sha256) if path else b""


def evidence_lines(finding: Finding, everything: bool = False) -> list[EvidenceLine]:
    """Return lines of evidence.

    Args:
        finding: the finding.
        everything: all evidence in full, not only the values that differ, and what matters most of the traceback and
            of what was printed.
    """
    evidence = finding.evidence
    lines = [
        EvidenceLine(label, _value(evidence[name]), Rank.VALUE)
        for label, name in (("expected", "first"), ("found", "second"))
        if evidence.get(name) is not None
    ]
    traceback = list(_traceback(_lines(evidence.get("traceback"))))
    lines += traceback if everything else most_important(traceback, _TRACEBACK)
    output = [EvidenceLine("printed", line, Rank.PRINTED) for line in _lines(evidence.get("output"))]
    lines += output if everything else output[-_PRINTED:]
    if everything:
        lines += [
            EvidenceLine(one_line(name), _value(value))
            for name, value in evidence.items()
            if name not in _APART and value is not None
        ]
    return lines


def most_important(lines: list[EvidenceLine], most: int) -> list[EvidenceLine]:
    """Return at most so many lines, those of the highest ranks and of one rank the last, in their order."""
    hidden = sorted(range(len(lines)), key=lambda number: lines[number].rank)[: max(len(lines) - most, 0)]
    return [line for number, line in enumerate(lines) if number not in hidden]


def _traceback(lines: list[str]) -> Iterator[EvidenceLine]:
    """Rank the lines of a traceback: its end is what raised, and the last file of the project led there."""
    starts = sorted({0, *(number for number, line in enumerate(lines) if _FRAME.match(line))})
    frames = [lines[start:end] for start, end in itertools.pairwise([*starts, len(lines)])]
    own = max((number for number, frame in enumerate(frames) if _is_own(frame)), default=None)
    for number, frame in enumerate(frames):
        code = next((line for line in reversed(frame) if not _MARKS.fullmatch(line)), None)
        for line in frame:
            rank = Rank.OTHER
            if number in (own, len(frames) - 1):
                place, raised = (Rank.OWN_PLACE, Rank.OWN) if number == own else (Rank.PLACE, Rank.RAISED)
                rank = raised if line is code else place if _FRAME.match(line) else Rank.MARKS
            yield EvidenceLine("", line, rank)


def _is_own(frame: list[str]) -> bool:
    """Whether a frame is one of the project, whose files a worker names without a folder of the machine."""
    place = _FRAME.match(frame[0]) if frame else None
    return place is not None and not (os.path.isabs(place[1]) or place[1].startswith("<"))


def lines_below(report: SubjectReport, finding: Finding) -> list[str]:
    """Return the lines that text shows below the message of a finding: its source line and its evidence."""
    source = source_line(report, finding)
    lines = [f"  {finding.line} | {source}"] if source else []
    return lines + [f"  {f'{line.label}: ' if line.label else ''}{line.words}" for line in evidence_lines(finding)]


def _lines(text: Any) -> list[str]:
    return [_cut(line) for line in str(text or "").splitlines() if line.strip()]


def _value(value: Any) -> str:
    return _cut(value if isinstance(value, str) else json.dumps(plain(value)))


def _cut(text: str) -> str:
    """Return one printable line of bounded length, with its indentation."""
    line = printable(text.expandtabs(4).replace("\n", " "))
    return line if len(line) <= _WIDTH else f"{line[: _WIDTH - 1]}…"
