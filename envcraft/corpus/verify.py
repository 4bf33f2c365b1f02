"""Whether a corpus is what was written: each source's digest, each row's references, each verdict's own rows.

What is taken out goes into ``lost+found`` in the corpus: files as they are, rows as lines of ``rows.jsonl``.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from envcraft.corpus.report import media
from envcraft.corpus.store import SOURCES, Store, decode, finding_rows
from envcraft.demonstrations import keeping
from envcraft.verdict import SubjectReport, plain

LOST = "lost+found"


class Damage(NamedTuple):
    """Something that is not as it was written, in words; what was done about it, empty where nothing was."""

    what: str
    done: str = ""


def verify(store: Store, repair: bool = False) -> Iterator[Damage]:
    """Give each damage, and with `repair` mend it. Raises sqlite3.Error, OSError."""
    damaged = False
    for damage in _database(store, repair):
        damaged = damaged or not damage.done
        yield damage
    if damaged and repair:
        # Rows of a database that is torn say nothing about the files.
        return
    yield from _references(store, repair)
    restored: set[str] = set()
    yield from _files(store, repair, restored)
    yield from _environments(store, repair, restored)
    yield from _attempts(store, repair, restored)
    yield from _verdicts(store, repair)
    yield from (
        Damage(words, "the next report makes it anew" if repair else "") for words in media.verify(store, repair)
    )
    yield from (
        Damage(words, "the next `envcraft demos` records it again" if repair else "")
        for words in keeping.verify(store, repair)
    )


def _database(store: Store, repair: bool) -> Iterator[Damage]:
    wrong = _integrity(store)
    if wrong and repair:
        # Only what is told from other rows can be made again.
        store.db.execute("REINDEX")
        if not _integrity(store):
            yield from (Damage(f"the database: {words}", "its indexes were made anew") for words in wrong)
            return
    yield from (Damage(f"the database: {words}") for words in wrong)


def _integrity(store: Store) -> list[str]:
    try:
        found = [" ".join(str(words).split()) for (words,) in store.db.execute("PRAGMA integrity_check(20)")]
    except sqlite3.DatabaseError as error:
        found = [str(error)]
    return [] if found == ["ok"] else found


def _references(store: Store, repair: bool) -> Iterator[Damage]:
    found = store.db.execute("SELECT * FROM pragma_foreign_key_check").fetchall()
    # One without row numbers is told of once for all its rows.
    for table, row, parent, _ in dict.fromkeys(found):
        if table == "environments":
            words = f"the environment in row {row} names a verdict that there is not"
            condition, done = f"rowid = {row}", "it counts as not judged"
        elif table == "attempts" and parent == "verdicts":
            words = "attempts at environments name verdicts that there are not"
            condition, done = "verdict NOT IN (SELECT id FROM verdicts)", "they count as not judged"
        elif parent == "concepts":
            words = f"{table} belong to a concept that there is not"
            condition, done = "concept NOT IN (SELECT id FROM concepts)", "they were set aside"
        elif table == "episodes":
            words = "episodes belong to a recording that there is not"
            condition, done = "demonstration NOT IN (SELECT id FROM demonstrations)", "they were set aside"
        elif row is None:
            words = "findings belong to a verdict that there is not"
            condition, done = "verdict NOT IN (SELECT id FROM verdicts)", "they were set aside"
        else:
            words = f"row {row} of {table} names a row of {parent} that there is not"
            condition, done = f"rowid = {row}", "it was set aside"
        if repair and parent == "verdicts" and table in ("environments", "attempts"):
            store.db.execute(f"UPDATE {table} SET verdict = NULL WHERE {condition}")
        elif repair:
            _set_rows_aside(store, table, condition)
        yield Damage(words, done if repair else "")


def _files(store: Store, repair: bool, restored: set[str]) -> Iterator[Damage]:
    """Every file among the sources; digests of those that lie where they do not belong are put into `restored`."""
    waiting = _walk(store.root / SOURCES)
    displaced: list[Path] = []
    while (file := displaced.pop() if displaced else next(waiting, None)) is not None:
        sha256 = _sha256(file)
        place = store.place(sha256)
        needed = store.named(sha256)
        if file == place and needed:
            continue
        parked = file.is_relative_to(store.root / LOST)
        name = file.relative_to(store.root)
        if file == place:
            words = f"{name} belongs to no environment, no verdict and no attempt"
        elif file.stem == sha256:
            words = f"{name} lies in the wrong folder"
        else:
            words = f"{name} has the digest {sha256}"
        back = needed and not (place.exists() and _sha256(place) == sha256)
        if back:
            restored.add(sha256)
        if repair and back:
            place.parent.mkdir(parents=True, exist_ok=True)
            if place.exists():
                # The next writer empties the folder for what is not finished.
                displaced.append(_set_file_aside(store, place))
            file.rename(place)
        elif repair and not parked:
            _set_file_aside(store, file)
        done = f"it was moved to {place.relative_to(store.root)}" if back else f"it was moved to {LOST}"
        yield Damage(words, done if repair else "")


def _environments(store: Store, repair: bool, restored: set[str]) -> Iterator[Damage]:
    cursor = store.db.execute("SELECT name, source FROM environments ORDER BY name")
    missing = [row for row in cursor if row[1] not in restored and not store.place(row[1]).is_file()]
    if not repair:
        # A file with other contents in its place has been told of.
        yield from (Damage(f"the source of {name} is missing") for name, _ in missing)
        return
    for name, _ in missing:
        _set_rows_aside(store, "environments", "name = ?", name)
        yield Damage(f"the source of {name} is missing", f"it was taken out, its row is in {LOST}/rows.jsonl")


def _attempts(store: Store, repair: bool, restored: set[str]) -> Iterator[Damage]:
    cursor = store.db.execute("SELECT concept, number, source FROM attempts ORDER BY concept, number")
    for concept, number, source in cursor.fetchall():
        if source in restored or store.place(source).is_file():
            continue
        if repair:
            _set_rows_aside(store, "attempts", "concept = ? AND number = ?", concept, number)
        done = f"it was taken out, its row is in {LOST}/rows.jsonl" if repair else ""
        yield Damage(f"the source of attempt {number} at the concept {concept} is missing", done)


def _verdicts(store: Store, repair: bool) -> Iterator[Damage]:
    """Every verdict: its report, and what the columns and the findings say of it."""
    # By number, since a repair writes meanwhile.
    numbers = [number for (number,) in store.db.execute("SELECT id FROM verdicts ORDER BY id")]
    for number in numbers:
        source, verdict, steps, text = store.db.execute(
            "SELECT source, verdict, steps, report FROM verdicts WHERE id = ?", (number,)
        ).fetchone()
        report = _decoded(text)
        if report is None:
            if repair:
                _set_rows_aside(store, "verdicts", "id = ?", number)
            yield Damage(f"verdict {number}: its report is no report", "it will be judged again" if repair else "")
            continue
        rows = store.db.execute(
            "SELECT rule_check, code, severity, line, message FROM findings WHERE verdict = ? ORDER BY number",
            (number,),
        ).fetchall()
        if (verdict, steps) == (report.verdict, report.steps) and rows == list(finding_rows(report)):
            continue
        if repair:
            with store.transaction():
                store.db.execute(
                    "UPDATE verdicts SET verdict = ?, steps = ?, seconds = ? WHERE id = ?",
                    (report.verdict.value, report.steps, report.seconds, number),
                )
                store.write_findings(number, report)
        yield Damage(
            f"verdict {number}, on source {source[:12]}: its rows are not what its report says",
            "they were made anew from it" if repair else "",
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
        # All at once: a repair moves files meanwhile.
        yield from [Path(parent, name) for name in sorted(files)]


def _set_file_aside(store: Store, file: Path) -> Path:
    """Give where it lies then."""
    folder = store.root / LOST
    folder.mkdir(exist_ok=True)
    number = 0
    while (aside := folder / (f"{file.name}.{number}" if number else file.name)).exists():
        number += 1
    return file.rename(aside)


def _set_rows_aside(store: Store, table: str, condition: str, *values: Any) -> None:
    """Write rows to the file of those that were lost, then delete them."""
    folder = store.root / LOST
    folder.mkdir(exist_ok=True)
    cursor = store.db.execute(f"SELECT * FROM {table} WHERE {condition}", values)
    columns = [column[0] for column in cursor.description]
    with open(folder / "rows.jsonl", "a", encoding="utf-8") as stream:
        for row in cursor:
            told = {"table": table, "row": dict(zip(columns, map(plain, row), strict=True))}
            stream.write(json.dumps(told) + "\n")
        stream.flush()
        os.fsync(stream.fileno())
    store.db.execute(f"DELETE FROM {table} WHERE {condition}", values)
