"""Compare an audit with an earlier report: new, fixed and unchanged findings, which are identified by fingerprints."""

from __future__ import annotations

import mmap
import os
import shlex
from collections import Counter
from typing import TYPE_CHECKING, BinaryIO

import msgspec

from envcraft.errors import UsageError
from envcraft.model.identity import fingerprint
from envcraft.model.verdict import SCHEMA, Verdict
from envcraft.text import one_line

if TYPE_CHECKING:
    from envcraft.corpus.audit import Audit


class _Finding(msgspec.Struct, frozen=True):
    code: str
    message: str


class _Check(msgspec.Struct, frozen=True):
    check: str
    findings: list[_Finding] = []
    known: list[_Finding] = []


class _Subject(msgspec.Struct, frozen=True):
    path: str
    checks: list[_Check]


class _Report(msgspec.Struct, frozen=True):
    """The part of a report that identifies findings, without the evidence and reproductions, which are most of it."""

    reports: list[_Subject]
    schema: int = SCHEMA


class Known(msgspec.Struct, frozen=True):
    """A finding of the audit or of the baseline."""

    path: str
    check: str
    code: str
    message: str
    fingerprint: str


class Difference(msgspec.Struct):
    """The difference between an audit and a baseline.

    Attributes:
        new: findings that only the audit has.
        fixed: findings that only the baseline has, although their check judged the environment again.
        unchanged: the number of findings that both have.
        unknown: the number of findings of the baseline whose check or environment was not judged again.
    """

    new: list[Known] = []
    fixed: list[Known] = []
    unchanged: int = 0
    unknown: int = 0


def read_baseline(path: str) -> dict[str, Known]:
    """Read the findings of a report.

    Args:
        path: a report in the format ``json``.

    Returns:
        The findings by fingerprint.

    Raises:
        UsageError: the file cannot be read, or is not a report.
    """
    hint = "a baseline is a report that `envcraft audit` or `envcraft validate` wrote with --format json"
    try:
        with open(path, "rb") as stream:
            report = _read(stream)
    except FileNotFoundError:
        command = f"envcraft validate TARGET --baseline '' --format json --output {shlex.quote(path)}"
        raise UsageError(f"the baseline {path} does not exist; `{command}` makes it", setting="baseline") from None
    except OSError as error:
        raise UsageError(f"the baseline {path} cannot be read ({error.strerror}); {hint}", setting="baseline") from None
    except (ValueError, RecursionError) as error:
        words = f"the baseline {path} is not a report ({one_line(error)}); {hint}"
        raise UsageError(words, setting="baseline") from None
    if report is None:
        raise UsageError(f"the baseline {path} is empty; {hint}", setting="baseline")
    if report.schema != SCHEMA:
        raise UsageError(f"{path} has schema {report.schema}, and this version of EnvCraft reads schema {SCHEMA}")
    known: dict[str, Known] = {}
    for subject in report.reports:
        seen: Counter[str] = Counter()
        name = _here(subject.path, path)
        for check in subject.checks:
            # A report that was made with a baseline is a baseline of all that it found.
            for finding in [*check.known, *check.findings]:
                key = fingerprint(name, finding.code, seen[finding.code])
                seen[finding.code] += 1
                known[key] = Known(name, check.check, finding.code, finding.message, key)
    return known


def _read(stream: BinaryIO) -> _Report | None:
    """The report in a file; None if the file is empty."""
    # A pipe has no size, and only what has one can be mapped.
    if not os.fstat(stream.fileno()).st_size:
        data = stream.read()
        return msgspec.json.decode(data, type=_Report) if data else None
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        return msgspec.json.decode(mapped, type=_Report)


def _here(path: str, report: str) -> str:
    """A path of a report as this folder names it. A report that was written elsewhere has paths from its own folder."""
    beside = os.path.join(os.path.dirname(report), path)
    return beside if not os.path.exists(path) and os.path.exists(beside) else path


def compare(audit: Audit, baseline: dict[str, Known]) -> Difference:
    """Compare an audit with the findings of a baseline.

    Args:
        audit: the audit.
        baseline: findings by fingerprint. The comparison removes those that the audit has.
    """
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
    # The findings of one environment are adjacent, so each report is read once.
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
    """Return for each check whether it judged the environment."""
    name = audit.name(path)
    report = None if name is None else audit.report(name)
    checks = report.checks if report is not None else []
    return {check.check: check.verdict in (Verdict.PASS, Verdict.FAIL) for check in checks}
