"""Validation records: for each environment what was judged, how, and the result, as one line of JSON."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterator
from typing import Any

import msgspec

from envcraft.corpus.store import Store, decode, verdicts
from envcraft.errors import UsageError
from envcraft.judging.settings import Settings
from envcraft.model.verdict import CheckReport, SubjectReport, Verdict, plain
from envcraft.text import one_line

SCHEMA = 1
#: Codes of environments whose traces may differ from run to run, except for one code.
_NOT_DETERMINISTIC, _DETERMINISTIC = "EC2", "EC209"


class CheckRecord(msgspec.Struct, frozen=True):
    """The verdict of one check, the codes of its findings, and a digest of their evidence (:func:`evidence`)."""

    check: str
    verdict: Verdict
    codes: list[str]
    evidence: str


class Record(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="record"):
    """What was judged, and the result.

    Attributes:
        schema: the version of this format.
        path: the name of the environment in its corpus.
        source_sha256: the digest of its source.
        env_class: the class to judge; None unless the source has several.
        envcraft: the version that judged.
        settings: contract, rules, seed, budget, driver, and the image or the libraries.
        isolation: the isolation of the driver.
        verdict: the verdict.
        steps: environment steps.
        traces: a digest of all rollouts; empty if it is unknown.
        checks: the verdict of each check.
        fail_fast: whether the judging ended at the first error.
        command: the command that judges it again, in the folder of the corpus or in the folder that it follows.
    """

    schema: int = SCHEMA
    path: str
    source_sha256: str
    env_class: str | None
    envcraft: str
    settings: Settings
    isolation: str
    verdict: Verdict
    steps: int
    traces: str
    checks: list[CheckRecord]
    command: str
    fail_fast: bool = False

    @property
    def deterministic(self) -> bool:
        """Whether no finding says that evidence and traces may differ from run to run."""
        codes = {code for check in self.checks for code in check.codes}
        return not any(code.startswith(_NOT_DETERMINISTIC) and code != _DETERMINISTIC for code in codes)


def records_of(store: Store) -> Iterator[Record]:
    """The records of the last verdicts on present sources, sorted by name, without errors and those out of time."""
    for row in verdicts.last(store):
        if row.report is None or row.settings is None or row.verdict == Verdict.ERROR:
            continue
        report = decode(row.report)
        if report.out_of_time:
            continue
        name, source, env_class = row.environment
        # Only a folder has its files by their names; a corpus has them by their digests.
        file = name if store.follows_folder else str(store.place(source).relative_to(store.root))
        yield record(name, file, source, env_class or None, row.settings, report)


def record(
    name: str, file: str, source: str, env_class: str | None, settings: Settings, report: SubjectReport
) -> Record:
    """The record of one verdict.

    Args:
        name: the name of the environment in its corpus.
        file: the path of its source, for the command.
        source: the digest of its source.
        env_class: the class to judge; None unless the source has several.
        settings: how it was judged.
        report: the verdict.
    """
    checks = [
        CheckRecord(check.check, check.verdict, [finding.code for finding in check.findings], evidence(check))
        for check in report.checks
    ]
    words = ["envcraft", "validate", file, "--contract", settings.contract, "--budget", settings.budget]
    words += ["--seed", str(settings.seed), "--sandbox", settings.driver]
    words += ["--checks", ",".join(check.check for check in checks)]
    words += ["--fail-fast"] if report.fail_fast else []
    words += ["--class", env_class] if env_class else []
    return Record(
        path=name,
        source_sha256=source,
        env_class=env_class,
        envcraft=settings.rules.rpartition("+")[0],
        settings=settings,
        isolation=report.isolation,
        verdict=report.verdict,
        steps=report.steps,
        traces=report.traces,
        checks=checks,
        command=shlex.join(words),
        fail_fast=report.fail_fast,
    )


def evidence(check: CheckReport) -> str:
    """The SHA-256 of the canonical JSON of codes, evidence and reproductions of a check, without wall times."""
    found = [
        (finding.code, {name: value for name, value in finding.evidence.items() if name != "seconds"}, finding.repro)
        for finding in check.findings
    ]
    return hashlib.sha256(msgspec.json.encode(plain(found), order="sorted")).hexdigest()


def read(path: str) -> list[Record]:
    """Read a file of records.

    Raises:
        UsageError: if the file cannot be read, or a line is not a record.
    """
    hint = "give a file that `envcraft corpus records` wrote, or a corpus"
    try:
        with open(path, "rb") as stream:
            lines = [_line(data, f"{path}, line {number}", hint) for number, data in enumerate(stream, 1)]
    except OSError as error:
        raise UsageError(f"cannot read the records {path} ({error.strerror}); {hint}") from None
    return [line for line in lines if line is not None]


def drift(recorded: Record, report: SubjectReport) -> tuple[list[str], list[str]]:
    """The differences of a new report from a record: in the verdicts, and in evidence and traces."""
    verdicts, details = [], []
    if report.verdict != recorded.verdict:
        verdicts.append(f"{report.verdict.value}, was {recorded.verdict.value}")
    present = {check.check: check for check in report.checks}
    for before in recorded.checks:
        check = present.get(before.check)
        if check is None or check.verdict != before.verdict:
            now = "not run" if check is None else check.verdict.value
            verdicts.append(f"{one_line(before.check)} {now}, was {before.verdict.value}")
        elif evidence(check) != before.evidence:
            details.append(f"{one_line(before.check)} with other evidence")
    if recorded.traces and report.traces != recorded.traces:
        details.append("other traces")
    return verdicts, details


def _line(data: bytes, where: str, hint: str) -> Record | None:
    """The record in a line; None for the last line of files that earlier versions wrote."""
    try:
        raw = msgspec.json.decode(data, type=dict[str, Any])
        if raw.get("kind") == "end":
            return None
        if raw.get("kind") == "record" and raw.get("schema") != SCHEMA:
            raise UsageError(f"{where} has schema {raw.get('schema')}, but this version of EnvCraft reads {SCHEMA}")
        return msgspec.convert(raw, Record)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{where} is not a record ({one_line(error)}); {hint}") from None
