"""Whether a corpus is as it was written: the digest of each source, the references of each row, the rows of verdicts.

Damaged files and rows are moved to ``lost+found`` in the corpus: files as they are, rows as lines of ``rows.jsonl``.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from envcraft.corpus.report import media
from envcraft.corpus.store import SOURCES, Store, decode, environments, generation, integrity, verdicts
from envcraft.corpus.store.rows import finding_rows
from envcraft.model.verdict import SubjectReport, plain

LOST = "lost+found"
#: Verifies files beside the sources: yields what is wrong, and with True removes it.
Verifier = Callable[[Store, bool], Iterator[str]]


class Damage(NamedTuple):
    """A difference from what was written: `what` is wrong, and what was `done` about it; empty if nothing."""

    what: str
    done: str = ""


def verify(store: Store, repair: bool = False, others: Mapping[str, Verifier] | None = None) -> Iterator[Damage]:
    """Find damage and optionally repair it.

    Args:
        store: the corpus, open for writing.
        repair: whether to repair.
        others: verifiers of further files, by what restores a removed file.

    Yields:
        Each damage, after its repair.

    Raises:
        sqlite3.Error: if the database cannot be read.
        OSError: if a file cannot be read or moved.
    """
    damaged = False
    for damage in _database(store, repair):
        damaged = damaged or not damage.done
        yield damage
    if damaged and repair:
        # The rows of a damaged database say nothing reliable about the files.
        return
    yield from _references(store, repair)
    restored: set[str] = set()
    yield from _files(store, repair, restored)
    yield from _environments(store, repair, restored)
    yield from _attempts(store, repair, restored)
    yield from _verdicts(store, repair)
    for done, verifier in {"the next report makes it again": media.verify, **(others or {})}.items():
        yield from (Damage(what, done if repair else "") for what in verifier(store, repair))


def _database(store: Store, repair: bool) -> Iterator[Damage]:
    errors = integrity.errors(store)
    if errors and repair:
        # Only indexes can be computed from other data.
        integrity.reindex(store)
        if not integrity.errors(store):
            yield from (Damage(f"the database: {words}", "its indexes were rebuilt") for words in errors)
            return
    yield from (Damage(f"the database: {words}") for words in errors)


def _references(store: Store, repair: bool) -> Iterator[Damage]:
    for table, row, parent in integrity.violations(store):
        if table == "environments":
            words = f"the environment in row {row} refers to a verdict that does not exist"
            condition, done = f"rowid = {row}", "it counts as not judged"
        elif table == "attempts" and parent == "verdicts":
            words = "attempts refer to verdicts that do not exist"
            condition, done = "verdict NOT IN (SELECT id FROM verdicts)", "they count as not judged"
        elif parent == "concepts":
            words = f"{table} refer to a concept that does not exist"
            condition, done = "concept NOT IN (SELECT id FROM concepts)", f"they were moved to {LOST}"
        elif table == "episodes":
            words = "episodes refer to a recording that does not exist"
            condition, done = "demonstration NOT IN (SELECT id FROM demonstrations)", f"they were moved to {LOST}"
        elif row is None:
            words = "findings refer to a verdict that does not exist"
            condition, done = "verdict NOT IN (SELECT id FROM verdicts)", f"they were moved to {LOST}"
        else:
            words = f"row {row} of {table} refers to a row of {parent} that does not exist"
            condition, done = f"rowid = {row}", f"it was moved to {LOST}"
        if repair and parent == "verdicts" and table in ("environments", "attempts"):
            integrity.clear_verdicts(store, table, condition)
        elif repair:
            _move_rows(store, table, condition)
        yield Damage(words, done if repair else "")


def _files(store: Store, repair: bool, restored: set[str]) -> Iterator[Damage]:
    """Check every file among the sources, and add the digests of misplaced ones that are needed to `restored`."""
    waiting = _walk(store.root / SOURCES)
    displaced: list[Path] = []
    while (file := displaced.pop() if displaced else next(waiting, None)) is not None:
        sha256 = _sha256(file)
        place = store.place(sha256)
        needed = store.is_referenced(sha256)
        if file == place and needed:
            continue
        moved = file.is_relative_to(store.root / LOST)
        name = file.relative_to(store.root)
        if file == place:
            words = f"{name} belongs to no environment, verdict or attempt"
        elif file.stem == sha256:
            words = f"{name} is in the wrong folder"
        else:
            words = f"{name} has the digest {sha256}"
        back = needed and not (place.exists() and _sha256(place) == sha256)
        if back:
            restored.add(sha256)
        if repair and back:
            place.parent.mkdir(parents=True, exist_ok=True)
            if place.exists():
                displaced.append(_move_file(store, place))
            file.rename(place)
        elif repair and not moved:
            _move_file(store, file)
        done = f"it was moved to {place.relative_to(store.root)}" if back else f"it was moved to {LOST}"
        yield Damage(words, done if repair else "")


def _environments(store: Store, repair: bool, restored: set[str]) -> Iterator[Damage]:
    missing = [
        one.name
        for one in environments.every(store)
        if one.source not in restored and not store.place(one.source).is_file()
    ]
    for name in missing:
        if repair:
            _move_rows(store, "environments", "name = ?", name)
        yield Damage(f"the source of {name} is missing", f"its row was moved to {LOST}/rows.jsonl" if repair else "")


def _attempts(store: Store, repair: bool, restored: set[str]) -> Iterator[Damage]:
    for concept, number, source, _ in generation.attempt_sources(store):
        if source in restored or store.place(source).is_file():
            continue
        if repair:
            _move_rows(store, "attempts", "concept = ? AND number = ?", concept, number)
        words = f"the source of attempt {number} at the concept {concept} is missing"
        yield Damage(words, f"its row was moved to {LOST}/rows.jsonl" if repair else "")


def _verdicts(store: Store, repair: bool) -> Iterator[Damage]:
    """Check that the columns and the findings of every verdict are those of its report."""
    for row in verdicts.rows(store):
        report = _decoded(row.report)
        if report is None:
            if repair:
                _move_rows(store, "verdicts", "id = ?", row.number)
            yield Damage(f"verdict {row.number}: its report is invalid", "it will be judged again" if repair else "")
            continue
        findings = verdicts.findings(store, row.number)
        if (row.verdict, row.steps) == (report.verdict, report.steps) and findings == list(finding_rows(report)):
            continue
        if repair:
            with store.transaction():
                verdicts.rewrite(store, row.number, report.verdict.value, report.steps, report.seconds)
                store.write_findings(row.number, report)
        yield Damage(
            f"verdict {row.number}, on source {row.source[:12]}: its rows differ from its report",
            "they were written again from it" if repair else "",
        )


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _decoded(text: Any) -> SubjectReport | None:
    try:
        return decode(text)
    except (msgspec.DecodeError, TypeError, RecursionError):
        return None


def _walk(folder: Path) -> Iterator[Path]:
    for parent, folders, files in os.walk(folder):
        folders.sort()
        # A list, because a repair moves files meanwhile.
        yield from [Path(parent, name) for name in sorted(files)]


def _move_file(store: Store, file: Path) -> Path:
    """Move a file to ``lost+found`` and return its new path."""
    folder = store.root / LOST
    folder.mkdir(exist_ok=True)
    number = 0
    while (moved := folder / (f"{file.name}.{number}" if number else file.name)).exists():
        number += 1
    return file.rename(moved)


def _move_rows(store: Store, table: str, condition: str, *values: Any) -> None:
    """Append rows to ``lost+found/rows.jsonl``, then delete them."""
    folder = store.root / LOST
    folder.mkdir(exist_ok=True)
    with open(folder / "rows.jsonl", "a", encoding="utf-8") as stream:
        for row in integrity.rows(store, table, condition, values):
            stream.write(json.dumps({"table": table, "row": {key: plain(value) for key, value in row.items()}}) + "\n")
        stream.flush()
        os.fsync(stream.fileno())
    integrity.delete(store, table, condition, values)
