"""Queries of an audit: which environments it selects, which of them have a verdict, and the results."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import msgspec

from envcraft.corpus.store.rows import Environment
from envcraft.corpus.store.store import MAY_BE_LAST, Store, now

#: The environments that an audit selects, in the temporary database of the connection.
_SELECTED = "CREATE TEMP TABLE chosen (name TEXT PRIMARY KEY) WITHOUT ROWID"
_VERDICTS = (
    "chosen JOIN environments USING (name) LEFT JOIN verdicts ON verdicts.source = environments.source "
    "AND verdicts.class = environments.class AND verdicts.settings = ?"
)


class Selection(msgspec.Struct, frozen=True):
    """Which environments an audit selects: by default all.

    Attributes:
        only_failed: those whose last verdict is not a pass, even if the source has changed since.
        changed: those that are new, or whose source or class has changed, since the last complete audit, and those
            without a verdict under the same settings.
        sample: a random sample of this size of the others' result.
        seed: the seed of the sample.
    """

    only_failed: bool = False
    changed: bool = False
    sample: int | None = None
    seed: int = 0


class FindingRow(NamedTuple):
    """A finding of an environment."""

    name: str
    check: str
    code: str
    message: str


def select(store: Store, selection: Selection, settings: int) -> tuple[int, bool]:
    """Fill the temporary table of selected environments.

    Args:
        store: the corpus.
        selection: which environments.
        settings: the row number of the settings of the audit.

    Returns:
        The number of selected environments, and whether all changed environments are among them.
    """
    conditions, complete = ["1"], not selection.only_failed
    if selection.only_failed:
        conditions.append("verdict IN (SELECT id FROM verdicts WHERE verdict IN ('fail', 'error'))")
    if selection.changed:
        conditions.append(
            "(changed > (SELECT coalesce(max(id), 0) FROM audits WHERE ended IS NOT NULL AND complete) "
            "OR NOT EXISTS (SELECT 1 FROM verdicts AS v WHERE v.source = environments.source "
            f"AND v.class = environments.class AND v.settings = {settings:d} AND v.verdict != 'error'))"
        )
    names = f"SELECT name FROM environments WHERE {' AND '.join(conditions)}"
    store.db.execute("DROP TABLE IF EXISTS chosen")
    store.db.execute(_SELECTED)
    if selection.sample is None:
        store.db.execute(f"INSERT INTO chosen {names}")
    else:
        found = [name for (name,) in store.db.execute(f"{names} ORDER BY name")]
        complete = complete and len(found) <= selection.sample
        sample = random.Random(selection.seed).sample(found, min(selection.sample, len(found)))
        store.db.executemany("INSERT INTO chosen VALUES (?)", [(name,) for name in sample])
    count: int = store.db.execute("SELECT count(*) FROM chosen").fetchone()[0]
    return count, complete


def pending(store: Store, settings: int, everything: bool) -> list[Environment]:
    """The selected environments without a verdict under settings, one for each source and class.

    Args:
        store: the corpus.
        settings: the row number of the settings.
        everything: whether to include those that have a verdict.
    """
    cursor = store.db.execute(
        # The first name of each source, so that the result does not depend on where an earlier run was interrupted.
        f"SELECT min(name), environments.source, environments.class FROM {_VERDICTS} "
        "WHERE verdicts.id IS NULL OR verdicts.verdict = 'error' OR ? "
        "GROUP BY environments.source, environments.class ORDER BY 1",
        (settings, everything),
    )
    return [Environment(*row) for row in cursor]


def start(store: Store, settings: int, selected: int, known: int, complete: bool) -> int:
    """Insert an audit, and make the verdicts that exist under its settings the last ones.

    Args:
        store: the corpus, open for writing.
        settings: the row number of the settings.
        selected: the number of selected environments.
        known: how many of them are not judged by this audit.
        complete: whether all changed environments are selected.

    Returns:
        The row number of the audit.
    """
    with store.transaction():
        store.db.execute(
            "UPDATE environments SET verdict = v.id FROM verdicts AS v WHERE v.source = environments.source "
            "AND v.class = environments.class AND v.settings = ? "
            f"AND environments.name IN (SELECT name FROM chosen) AND {MAY_BE_LAST}",
            (settings, settings),
        )
        cursor = store.db.execute(
            "INSERT INTO audits (settings, started, selected, known, complete) VALUES (?, ?, ?, ?, ?)",
            (settings, now(), selected, known, complete),
        )
    assert cursor.lastrowid is not None
    return cursor.lastrowid


def end(store: Store, audit: int) -> None:
    """Set the end of an audit."""
    store.db.execute("UPDATE audits SET ended = ? WHERE id = ?", (now(), audit))


def is_selected(store: Store, name: str) -> bool:
    """Whether an environment is selected."""
    return store.db.execute("SELECT 1 FROM chosen WHERE name = ?", (name,)).fetchone() is not None


def reports(store: Store, settings: int) -> Iterator[tuple[str, str]]:
    """The name and the report as JSON of each selected environment with a verdict, sorted by name."""
    yield from _rows(store, settings, "name, report", "report IS NOT NULL ORDER BY name")


def report(store: Store, settings: int, name: str) -> str | None:
    """The report on a selected environment as JSON; None if there is none."""
    row = next(_rows(store, settings, "report", "name = ? AND report IS NOT NULL", name), None)
    return None if row is None else row[0]


def findings(store: Store, settings: int) -> Iterator[FindingRow]:
    """The findings of all selected environments, sorted by name and in the order of the reports."""
    cursor = store.db.execute(
        f"SELECT name, rule_check, code, message FROM {_VERDICTS} JOIN findings ON findings.verdict = verdicts.id "
        "ORDER BY name, number",
        (settings,),
    )
    return map(FindingRow._make, cursor)


def verdict_counts(store: Store, settings: int) -> dict[str, int]:
    """The number of selected environments with each verdict."""
    return dict(
        _rows(store, settings, "verdicts.verdict, count(*)", "verdicts.id IS NOT NULL GROUP BY verdicts.verdict")
    )


def code_counts(store: Store, settings: int) -> dict[str, int]:
    """The number of selected environments with each code, the most frequent code first."""
    cursor = store.db.execute(
        f"SELECT code, count(DISTINCT name) AS times FROM {_VERDICTS} JOIN findings "
        "ON findings.verdict = verdicts.id GROUP BY code ORDER BY times DESC, code",
        (settings,),
    )
    return dict(cursor)


def totals(store: Store, settings: int) -> tuple[int, float]:
    """The environment steps and the seconds of the verdicts on all selected environments."""
    row: tuple[int, float] = next(_rows(store, settings, "coalesce(sum(steps), 0), coalesce(sum(seconds), 0.0)", "1"))
    return row


def replace_environments(store: Store, names: Iterable[str]) -> None:
    """Remove the environments that are not among `names`, inside a transaction; their verdicts stay.

    `names` may add environments while it is read.
    """
    store.db.execute("CREATE TEMP TABLE IF NOT EXISTS present (name TEXT PRIMARY KEY) WITHOUT ROWID")
    store.db.execute("DELETE FROM present")
    for name in names:
        store.db.execute("INSERT INTO present VALUES (?)", (name,))
    gone = "name NOT IN (SELECT name FROM present)"
    for (sha256,) in store.db.execute(f"SELECT source FROM environments WHERE {gone}"):
        store.release(sha256)
    store.db.execute(f"DELETE FROM environments WHERE {gone}")


def _rows(store: Store, settings: int, columns: str, condition: str, *values: Any) -> Iterator[Any]:
    yield from store.db.execute(f"SELECT {columns} FROM {_VERDICTS} WHERE {condition}", (settings, *values))
