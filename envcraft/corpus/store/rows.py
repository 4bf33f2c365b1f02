"""Rows of the tables as Python values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec

from envcraft.model.verdict import SubjectReport, plain


class Environment(NamedTuple):
    """An environment: `source` is a SHA-256 in hex, `env_class` is empty unless the file has several classes."""

    name: str
    source: str
    env_class: str


def decode(report: str) -> SubjectReport:
    """Decode a report as the table stores it.

    Raises:
        msgspec.DecodeError: if the text is not a report.
    """
    return msgspec.json.decode(report, type=SubjectReport)


def encode(report: SubjectReport) -> str:
    """Encode a report as the table stores it."""
    return msgspec.json.encode(plain(report)).decode()


def finding_rows(report: SubjectReport) -> Iterator[tuple[Any, ...]]:
    """Yield the findings of a report in order: check, code, severity, line, message."""
    for check in report.checks:
        for finding in check.findings:
            yield tuple(plain([check.check, finding.code, finding.severity, finding.line, finding.message]))
