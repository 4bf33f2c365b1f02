"""Validation records: of each environment what was judged, under what, and what came out, as one line of JSON.

Each line has the digest of the one before it and one of its own, the SHA-256 of its canonical JSON without ``digest``:
keys sorted, no spaces, UTF-8. The last line has their number. So a line that is changed, left out or moved shows.
Nothing in there is secret: who can write the file can write another one as a whole, which only its last digest, kept
elsewhere, tells from this one.
"""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Iterable, Iterator
from typing import Any, TypeVar

import msgspec

from envcraft.corpus.settings import Settings
from envcraft.corpus.store import Store, decode
from envcraft.errors import UsageError
from envcraft.reports import one_line
from envcraft.verdict import CheckReport, SubjectReport, Verdict, plain

SCHEMA = 1
#: Findings by which a trace need not be the same when it is played again, but for one that says it always is.
_UNSTEADY, _SAME_LEVEL = "EC2", "EC209"


class Checked(msgspec.Struct, frozen=True):
    """One check's verdict, the codes that it found, and a digest of their evidence (:func:`evidence`)."""

    check: str
    verdict: Verdict
    codes: list[str]
    evidence: str


class Record(msgspec.Struct, frozen=True, kw_only=True, tag_field="kind", tag="record"):
    """What was judged, and what came out.

    Attributes:
        path: the environment's name in its corpus.
        source_sha256: the digest of its file.
        env_class: picks one of several classes of the file.
        envcraft: the version that judged.
        settings: contract, rules, seed, budget, driver, and the image or the libraries.
        isolation: that of the driver.
        steps: environment steps.
        traces: a digest of all that was played, empty where that is not known.
        command: what judges it again by hand, in the folder of the corpus, or in the one that the corpus follows.
        previous: the digest of the line before, empty in the first.
        digest: of all the rest.
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
    checks: list[Checked]
    command: str
    previous: str = ""
    digest: str = ""

    @property
    def unsteady(self) -> bool:
        """Whether it was found not to be deterministic, so that evidence and traces may differ from run to run."""
        codes = {code for check in self.checks for code in check.codes}
        return any(code.startswith(_UNSTEADY) and code != _SAME_LEVEL for code in codes)


class End(msgspec.Struct, frozen=True, tag_field="kind", tag="end"):
    """The last line: how many `records` there are."""

    records: int
    previous: str = ""
    digest: str = ""


_Line = TypeVar("_Line", Record, End)


def records_of(store: Store) -> Iterator[Record]:
    """The last verdict on each present source and class, in the order of names, not chained yet; what could not be
    judged is left out.
    """
    rows = store.db.execute(
        "SELECT name, environments.source, environments.class, report, contract, contract_sha256, rules, seed, budget, "
        "driver, image, settings.checks, offered FROM environments JOIN verdicts ON verdicts.id = environments.verdict "
        "AND verdicts.source = environments.source AND verdicts.class = environments.class "
        "JOIN settings ON settings.id = verdicts.settings "
        "WHERE verdicts.verdict != ? ORDER BY name",
        (Verdict.ERROR.value,),
    )
    for name, source, env_class, report, *settings in rows:
        # A corpus has its files by their digests, and only who follows a folder has them by their names.
        file = name if store.follows_folder else str(store.place(source).relative_to(store.root))
        yield record(name, file, source, env_class or None, Settings(*settings), decode(report))


def record(
    name: str, file: str, source: str, env_class: str | None, settings: Settings, report: SubjectReport
) -> Record:
    """The record of one verdict; `file` is where the source lies."""
    checks = [
        Checked(check.check, check.verdict, [finding.code for finding in check.findings], evidence(check))
        for check in report.checks
    ]
    words = ["envcraft", "validate", file, "--contract", settings.contract, "--budget", settings.budget]
    words += ["--seed", str(settings.seed), "--sandbox", settings.driver]
    words += ["--checks", ",".join(check.check for check in checks)]
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
    )


def evidence(check: CheckReport) -> str:
    """The SHA-256 of the canonical JSON of what a check found: codes, evidence, reproductions; without wall times."""
    told = [
        (found.code, {name: value for name, value in found.evidence.items() if name != "seconds"}, found.repro)
        for found in check.findings
    ]
    return _digest(plain(told))


def chain(records: Iterable[Record]) -> Iterator[Record | End]:
    """The lines of a file: each record with its place in the chain, then the end."""
    previous, count = "", 0
    for line in records:
        sealed = _seal(line, previous)
        previous, count = sealed.digest, count + 1
        yield sealed
    yield _seal(End(count), previous)


def encode(line: Record | End) -> bytes:
    """A line of a file."""
    return msgspec.json.encode(line) + b"\n"


def read(path: str) -> list[Record]:
    """The records of a file whose chain is whole. Raises UsageError, naming the line where it is not."""
    hint = "give a file that `envcraft corpus records` wrote, or a corpus"
    found: list[Record] = []
    previous, number, ended = "", 0, False
    try:
        with open(path, "rb") as stream:
            for number, data in enumerate(stream, 1):
                line = _line(data, f"{path}, line {number}", hint)
                if ended or line.previous != previous:
                    raise UsageError(
                        f"{path}, line {number}: it does not follow the line before; one was moved or removed"
                    )
                previous, ended = line.digest, isinstance(line, End)
                if isinstance(line, Record):
                    found.append(line)
                elif line.records != len(found):
                    raise UsageError(
                        f"{path}, line {number}: it counts {line.records} records, and there are {len(found)}"
                    )
    except OSError as error:
        raise UsageError(f"the records {path} cannot be read ({error.strerror}); {hint}") from None
    if not ended:
        raise UsageError(f"{path} ends after line {number} without the line that counts the records: it was cut off")
    return found


def drift(known: Record, report: SubjectReport) -> tuple[list[str], list[str]]:
    """In words, what is not as it was recorded: in the verdicts, and in evidence and traces."""
    verdicts, details = [], []
    if report.verdict != known.verdict:
        verdicts.append(f"{report.verdict.value}, was {known.verdict.value}")
    present = {check.check: check for check in report.checks}
    for recorded in known.checks:
        check = present.get(recorded.check)
        if check is None or check.verdict != recorded.verdict:
            now = "not run" if check is None else check.verdict.value
            verdicts.append(f"{one_line(recorded.check)} {now}, was {recorded.verdict.value}")
        elif evidence(check) != recorded.evidence:
            details.append(f"{one_line(recorded.check)} with other evidence")
    if known.traces and report.traces != known.traces:
        details.append("other traces")
    return verdicts, details


def _line(data: bytes, where: str, hint: str) -> Record | End:
    """Raises UsageError on what is no line of such a file, or has another digest than it says."""
    try:
        raw = msgspec.json.decode(data, type=dict[str, Any])
        if raw.get("kind") == "record" and raw.get("schema") != SCHEMA:
            raise UsageError(f"{where} has schema {raw.get('schema')}, and this version of EnvCraft reads {SCHEMA}")
        line: Record | End = msgspec.convert(raw, Record | End)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise UsageError(f"{where} is no record ({one_line(error)}); {hint}") from None
    # Of all that is there, so that nothing can be added either.
    if _digest({name: value for name, value in raw.items() if name != "digest"}) != line.digest:
        raise UsageError(f"{where}: it was changed, its digest is another one")
    return line


def _seal(line: _Line, previous: str) -> _Line:
    told = msgspec.to_builtins(msgspec.structs.replace(line, previous=previous))
    del told["digest"]
    return msgspec.structs.replace(line, previous=previous, digest=_digest(told))


def _digest(told: Any) -> str:
    return hashlib.sha256(msgspec.json.encode(told, order="sorted")).hexdigest()
