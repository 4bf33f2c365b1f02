"""What a finding is shown with: the line of the file, the values that differ, the traceback, and what was printed."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from envcraft.model.target import Kind, read_known
from envcraft.model.verdict import Finding, SubjectReport, plain
from envcraft.text import one_line, printable

_WIDTH = 200
#: The end of a traceback is where it was raised, and the last lines are what was printed last.
_TRACEBACK, _PRINTED = 6, 3
#: Evidence that is shown in a form of its own, or that the message or the reproduction has already.
_APART = {"traceback", "output", "first", "second", "field", "step", "cell"}
#: The last sources that are no whole files, by digest, with the first lines of their cells, and how many are kept.
_kept: dict[str, tuple[bytes, Mapping[str, int]]] = {}
_KEPT = 64


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
        return report.file
    cell = finding.evidence.get("cell")
    return f"{report.file}:{finding.line}" if cell is None else f"{cell}, line {finding.line}"


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


def evidence_lines(finding: Finding, everything: bool = False) -> list[tuple[str, str]]:
    """Return lines of evidence, each with its label.

    Args:
        finding: the finding.
        everything: all evidence in full, not only the values that differ, and the end of the traceback and of what was
            printed.
    """
    evidence = finding.evidence
    lines = [
        (label, _value(evidence[name]))
        for label, name in (("expected", "first"), ("found", "second"))
        if evidence.get(name) is not None
    ]
    traceback = _lines(evidence.get("traceback"))
    lines += [("", line) for line in (traceback if everything else traceback[-_TRACEBACK:])]
    output = _lines(evidence.get("output"))
    lines += [("printed", line) for line in (output if everything else output[-_PRINTED:])]
    if everything:
        lines += [
            (one_line(name), _value(value))
            for name, value in evidence.items()
            if name not in _APART and value is not None
        ]
    return lines


def lines_below(report: SubjectReport, finding: Finding) -> list[str]:
    """Return the lines that text shows below the message of a finding: its source line and its evidence."""
    source = source_line(report, finding)
    lines = [f"  {finding.line} | {source}"] if source else []
    return lines + [f"  {f'{label}: ' if label else ''}{words}" for label, words in evidence_lines(finding)]


def _lines(text: Any) -> list[str]:
    return [_cut(line) for line in str(text or "").splitlines() if line.strip()]


def _value(value: Any) -> str:
    return _cut(value if isinstance(value, str) else json.dumps(plain(value)))


def _cut(text: str) -> str:
    """Return one printable line of bounded length, with its indentation."""
    line = printable(text.expandtabs(4).replace("\n", " "))
    return line if len(line) <= _WIDTH else f"{line[: _WIDTH - 1]}…"
