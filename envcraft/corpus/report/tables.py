"""The report's numbers as CSV files, and as JSON in ``report.json`` and ``environments.json``."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from envcraft.corpus.report.data import Entry, Survey
from envcraft.judging.check import Rule
from envcraft.judging.statistics import Proportion
from envcraft.model.verdict import Outcome, plain
from envcraft.version import __version__

SCHEMA = 1
STAGES = ("stage", "input", "failed", "not_judged", "skipped", "undecided", "output", "pass_rate", "low", "high")
ENVIRONMENTS = (
    "name",
    "class",
    "source",
    "verdict",
    "undecided",
    "codes",
    "steps",
    "seconds",
    "lines",
    "added",
    "cluster",
)
FINDINGS = ("name", "check", "code", "severity", "line", "message")
CODES = ("code", "name", "check", "severity", "environments", "findings")
#: First characters of a cell that spreadsheets evaluate as a formula.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


class Tables:
    """Writes the files with one row for each environment or finding. Use it as a context manager.

    Args:
        folder: an existing folder.
    """

    def __init__(self, folder: Path) -> None:
        self._files = ExitStack()
        self._environments = self._csv(folder / "environments.csv", ENVIRONMENTS)
        self._findings = self._csv(folder / "findings.csv", FINDINGS)
        self._json = self._files.enter_context((folder / "environments.json").open("wb"))
        self._json.write(b"[")
        self._first = True

    def __enter__(self) -> Tables:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._json.write(b"\n]\n")
        self._files.close()

    def _csv(self, path: Path, columns: Iterable[str]) -> Any:
        writer = csv.writer(self._files.enter_context(path.open("w", encoding="utf-8", newline="")))
        writer.writerow(columns)
        return writer

    def add(self, entry: Entry, lines: int, cluster: int | None) -> None:
        """Write one environment.

        Args:
            entry: the environment.
            lines: of its source.
            cluster: the number of its cluster of near-duplicates, if it is in one.
        """
        name, source, env_class = plain(list(entry.environment))
        report = entry.report
        steps, seconds = (report.steps, report.seconds) if report is not None else (None, None)
        lists = (" ".join(entry.undecided), " ".join(entry.codes))
        cells = [name, env_class, source, entry.verdict, *lists, steps, seconds, lines, entry.added]
        self._environments.writerow(map(cell, [*cells, cluster]))
        findings = []
        for check in report.checks if report is not None else ():
            for finding in check.findings:
                row = plain([check.check, finding.code, finding.severity, finding.line, finding.message])
                self._findings.writerow(map(cell, [name, *row]))
                findings.append(dict(zip(FINDINGS[1:], row, strict=True)))
        record = {
            **dict(zip(ENVIRONMENTS, [*cells, cluster], strict=True)),
            "undecided": entry.undecided,
            "codes": entry.codes,
            "origin": entry.origin,
            "findings": findings,
        }
        self._json.write((b"\n" if self._first else b",\n") + msgspec.json.encode(plain(record)))
        self._first = False


def cell(value: Any) -> Any:
    """Return a cell of a CSV file. Text that a spreadsheet would evaluate gets an apostrophe as a prefix."""
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value


def write_summary(folder: Path, survey: Survey, rules: dict[str, Rule], more: dict[str, Any]) -> None:
    """Write the small tables, and ``report.json`` with all of them.

    Args:
        folder: an existing folder.
        survey: the counts.
        rules: the rules by code.
        more: further fields of ``report.json``.
    """
    stages = [
        {
            **dict(
                zip(STAGES, (s.name, s.entered, s.failed, s.unjudged, s.skipped, s.undecided, s.left), strict=False)
            ),
            **_rate(s.rate),
        }
        for s in survey.stages()
    ]
    codes = [
        dict(zip(CODES, plain([row.code, _name(rules, row.code), *_counts(row)]), strict=True))
        for row in survey.codes()
    ]
    for name, columns, rows in (("stages.csv", STAGES, stages), ("codes.csv", CODES, codes)):
        with open(folder / name, "w", encoding="utf-8", newline="") as stream:
            writer = csv.DictWriter(stream, columns)
            writer.writeheader()
            writer.writerows({key: cell(value) for key, value in row.items()} for row in rows)
    summary = {
        "schema": SCHEMA,
        "envcraft": __version__,
        **more,
        "environments": survey.total,
        "judged": survey.judged,
        "verdicts": survey.verdicts,
        "undecided": survey.outcomes[Outcome.UNDECIDED],
        "steps": survey.steps,
        "seconds": survey.seconds,
        "stages": stages,
        "checks": [{"check": row.name, "seconds": row.seconds, **row.outcomes} for row in survey.checks()],
        "codes": codes,
        "attempts": [
            {"attempt": a.number, "judged": a.judged, "passed": a.passed, "undecided": a.undecided}
            for a in survey.attempts()
        ],
        "measures": [
            {"measure": m.name, **dict(zip(("median", "p90", "highest"), m.quantiles(0.5, 0.9, 1), strict=False))}
            for m in survey.measures
        ],
        "outliers": [{"name": survey.names[o.number], **msgspec.structs.asdict(o)} for o in survey.outliers()],
    }
    (folder / "report.json").write_text(json.dumps(plain(summary), indent=1) + "\n", "utf-8")


def _name(rules: dict[str, Rule], code: str) -> str:
    return rules[code].name if code in rules else ""


def _counts(row: Any) -> list[Any]:
    return [row.check, row.severity, row.environments, row.findings]


def _rate(rate: Proportion) -> dict[str, float]:
    return {"pass_rate": rate.estimate, "low": rate.low, "high": rate.high} if rate.n else {}
