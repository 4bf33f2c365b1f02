"""What is new since an earlier report, what is fixed, and what is as it was; findings are known by fingerprints."""

from __future__ import annotations

import mmap
from collections import Counter
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import UsageError
from envcraft.model.verdict import SCHEMA, Verdict
from envcraft.reports.summary import fingerprint
from envcraft.text import one_line

if TYPE_CHECKING:
    from envcraft.corpus.audit import Audit


class _Finding(msgspec.Struct, frozen=True):
    code: str
    message: str


class _Check(msgspec.Struct, frozen=True):
    check: str
    findings: list[_Finding] = []


class _Subject(msgspec.Struct, frozen=True):
    path: str
    checks: list[_Check]


class _Report(msgspec.Struct, frozen=True):
    """The part of a report that findings are known by: evidence and reproductions are most of it."""

    reports: list[_Subject]
    schema: int = SCHEMA


class Known(msgspec.Struct, frozen=True):
    """A finding of either side."""

    path: str
    check: str
    code: str
    message: str
    fingerprint: str


class Difference(msgspec.Struct):
    """How an audit differs from a baseline. `unknown` findings are those whose check did not run now, or whose
    environment the audit is not about.
    """

    new: list[Known] = []
    fixed: list[Known] = []
    unchanged: int = 0
    unknown: int = 0


def read_baseline(path: str) -> dict[str, Known]:
    """The findings of a report by their fingerprints. Raises UsageError."""
    hint = "give what `envcraft audit` or `envcraft validate` wrote with --format json"
    try:
        with open(path, "rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            report = msgspec.json.decode(data, type=_Report)
    except OSError as error:
        raise UsageError(f"the baseline {path} cannot be read ({error.strerror}); {hint}") from None
    except (ValueError, RecursionError) as error:
        raise UsageError(f"the baseline {path} is no report ({one_line(error)}); {hint}") from None
    if report.schema != SCHEMA:
        raise UsageError(f"{path} has schema {report.schema}, and this version of EnvCraft reads schema {SCHEMA}")
    found: dict[str, Known] = {}
    for subject in report.reports:
        seen: Counter[str] = Counter()
        for check in subject.checks:
            for finding in check.findings:
                key = fingerprint(subject.path, finding.code, seen[finding.code])
                seen[finding.code] += 1
                found[key] = Known(subject.path, check.check, finding.code, finding.message, key)
    return found


def compare(audit: Audit, baseline: dict[str, Known]) -> Difference:
    """Hold an audit against the findings of a baseline, which are used up."""
    difference = Difference()
    seen: Counter[str] = Counter()
    last = ""
    for path, check, code, message in audit.findings():
        if path != last:
            last, seen = path, Counter()
        key = fingerprint(path, code, seen[code])
        seen[code] += 1
        if baseline.pop(key, None) is None:
            difference.new.append(Known(path, check, code, message, key))
        else:
            difference.unchanged += 1
    # Those of one environment lie together, so that each report is read once.
    ran: dict[str, bool] = {}
    last = ""
    for known in baseline.values():
        if known.path != last:
            last, ran = known.path, _ran(audit, known.path)
        if ran.get(known.check):
            difference.fixed.append(known)
        else:
            difference.unknown += 1
    return difference


def _ran(audit: Audit, path: str) -> dict[str, bool]:
    """Which checks judged an environment, so that what they no longer find is not there."""
    name = audit.name(path)
    report = None if name is None else audit.report(name)
    checks = report.checks if report is not None else []
    return {check.check: check.verdict in (Verdict.PASS, Verdict.FAIL) for check in checks}
