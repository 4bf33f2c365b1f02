"""Queries of an audit: which environments it selects, which of them have a verdict, and the results."""

from __future__ import annotations

import json
import random
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import msgspec

from envcraft.corpus.store.rows import Environment
from envcraft.corpus.store.store import MAY_BE_LAST, UNDECIDED, UNSETTLED, Store, now

#: The environments that an audit selects, each with the settings whose verdict counts, in the temporary database of the
#: connection.
_SELECTED = "CREATE TEMP TABLE chosen (name TEXT PRIMARY KEY, settings INTEGER) WITHOUT ROWID"
_VERDICTS = (
    "chosen JOIN environments USING (name) LEFT JOIN verdicts ON verdicts.source = environments.source "
    "AND verdicts.class = environments.class AND verdicts.settings = chosen.settings"
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


#: The SHA-256 of each file of its project that an environment needs, by source and class.
Projects = Mapping[tuple[str, str], Mapping[str, str]]


class FindingRow(NamedTuple):
    """A finding of an environment."""

    name: str
    check: str
    code: str
    message: str


def outdated(store: Store, settings: int, projects: Projects) -> list[int]:
    """Find the verdicts with other files of a project than the present ones, and mark their environments as changed.

    Args:
        store: the corpus of a folder, open for writing.
        settings: the row number of the settings.
        projects: the present files of each environment that has some.

    Returns:
        The row numbers of these verdicts.
    """
    cursor = store.db.execute(
        "SELECT id, verdicts.source, verdicts.class, json_extract(report, '$.project.files') FROM verdicts "
        "JOIN (SELECT DISTINCT source, class FROM environments) AS present "
        "ON present.source = verdicts.source AND present.class = verdicts.class WHERE settings = ?",
        (settings,),
    )
    found = [
        (source, env_class, number)
        for number, source, env_class, files in cursor
        if (json.loads(files) if files else {}) != projects.get((source, env_class), {})
    ]
    store.db.executemany(
        "UPDATE environments SET changed = 1 + coalesce((SELECT max(id) FROM audits), 0) "
        "WHERE source = ? AND class = ?",
        [row[:2] for row in found],
    )
    return [number for _, _, number in found]


def forget(store: Store, numbers: Iterable[int]) -> None:
    """Delete verdicts by their row numbers."""
    store.db.executemany("DELETE FROM verdicts WHERE id = ?", [(number,) for number in numbers])


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
            f"AND v.class = environments.class AND v.settings = {settings:d} AND NOT {UNSETTLED.format('v')}))"
        )
    names = f"SELECT name, {settings:d} FROM environments WHERE {' AND '.join(conditions)}"
    store.db.execute("DROP TABLE IF EXISTS chosen")
    store.db.execute(_SELECTED)
    if selection.sample is None:
        store.db.execute(f"INSERT INTO chosen {names}")
    else:
        found = store.db.execute(f"{names} ORDER BY name").fetchall()
        complete = complete and len(found) <= selection.sample
        sample = random.Random(selection.seed).sample(found, min(selection.sample, len(found)))
        store.db.executemany("INSERT INTO chosen VALUES (?, ?)", sample)
    count: int = store.db.execute("SELECT count(*) FROM chosen").fetchone()[0]
    return count, complete


def advance(store: Store, earlier: int, settings: int) -> int:
    """Let other settings count for the selected environments that pass under earlier ones.

    Args:
        store: the corpus.
        earlier: the row number of the earlier settings.
        settings: the row number of the others.

    Returns:
        The number of these environments.
    """
    passed = f"SELECT name FROM {_VERDICTS} WHERE chosen.settings = ? AND verdicts.verdict = 'pass'"
    return store.db.execute(f"UPDATE chosen SET settings = ? WHERE name IN ({passed})", (settings, earlier)).rowcount


def pending(store: Store, settings: int, everything: bool, complete: bool = False) -> list[Environment]:
    """The environments for which settings count and that have no settled verdict, one for each source and class.

    Args:
        store: the corpus.
        settings: the row number of the settings.
        everything: whether to include those that have a verdict.
        complete: whether to include those whose judging ended at the first error.
    """
    ended_early = "coalesce(json_extract(verdicts.report, '$.fail_fast'), 0)"
    cursor = store.db.execute(
        # The first name of each source, so that the result does not depend on where an earlier run was interrupted.
        f"SELECT min(name), environments.source, environments.class FROM {_VERDICTS} "
        f"WHERE chosen.settings = ? AND (verdicts.id IS NULL OR {UNSETTLED.format('verdicts')} "
        f"OR ? OR (? AND {ended_early})) GROUP BY environments.source, environments.class ORDER BY 1",
        (settings, everything, complete),
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
            f"AND environments.name IN (SELECT name FROM chosen WHERE settings = ?) AND {MAY_BE_LAST}",
            (settings, settings, settings),
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


def reports(store: Store) -> Iterator[tuple[str, str]]:
    """The name and the report as JSON of each selected environment with a verdict, sorted by name."""
    yield from _rows(store, "name, report", "report IS NOT NULL ORDER BY name")


def report(store: Store, name: str) -> str | None:
    """The report on a selected environment as JSON; None if there is none."""
    row = next(_rows(store, "report", "name = ? AND report IS NOT NULL", name), None)
    return None if row is None else row[0]


def findings(store: Store) -> Iterator[FindingRow]:
    """The findings of all selected environments, sorted by name and in the order of the reports."""
    cursor = store.db.execute(
        f"SELECT name, rule_check, code, message FROM {_VERDICTS} JOIN findings ON findings.verdict = verdicts.id "
        "ORDER BY name, number"
    )
    return map(FindingRow._make, cursor)


def verdict_counts(store: Store) -> dict[str, int]:
    """The number of selected environments with each verdict."""
    return dict(_rows(store, "verdicts.verdict, count(*)", "verdicts.id IS NOT NULL GROUP BY verdicts.verdict"))


def undecided(store: Store) -> int:
    """The number of selected environments that pass and have a check that left its question open."""
    count: int = next(_rows(store, "count(*)", UNDECIDED.format("verdicts")))[0]
    return count


def undecided_checks(store: Store) -> dict[str, int]:
    """The number of selected environments that each check left undecided, the most frequent check first."""
    cursor = store.db.execute(
        f"SELECT json_extract(one.value, '$.check') AS name_of, count(*) AS times FROM {_VERDICTS}, "
        f"json_each(verdicts.report, '$.checks') AS one WHERE {UNDECIDED.format('verdicts')} "
        "AND json_extract(one.value, '$.undecided') AND json_extract(one.value, '$.verdict') = 'skip' "
        "GROUP BY name_of ORDER BY times DESC, name_of"
    )
    return dict(cursor)


def code_counts(store: Store) -> dict[str, int]:
    """The number of selected environments with each code, the most frequent code first."""
    cursor = store.db.execute(
        f"SELECT code, count(DISTINCT name) AS times FROM {_VERDICTS} JOIN findings "
        "ON findings.verdict = verdicts.id GROUP BY code ORDER BY times DESC, code"
    )
    return dict(cursor)


def warning_codes(store: Store) -> set[str]:
    """The codes that selected environments have as warnings only."""
    cursor = store.db.execute(
        f"SELECT code FROM {_VERDICTS} JOIN findings ON findings.verdict = verdicts.id GROUP BY code "
        "HAVING min(severity = 'warning')"
    )
    return {code for (code,) in cursor}


def totals(store: Store) -> tuple[int, float]:
    """The environment steps and the seconds of the verdicts on all selected environments."""
    row: tuple[int, float] = next(_rows(store, "coalesce(sum(steps), 0), coalesce(sum(seconds), 0.0)", "1"))
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


def out_of_time(store: Store) -> int:
    """The number of selected environments whose verdict the clock decided."""
    count: int = next(_rows(store, "count(*)", "json_extract(report, '$.out_of_time')"))[0]
    return count


def _rows(store: Store, columns: str, condition: str, *values: Any) -> Iterator[Any]:
    yield from store.db.execute(f"SELECT {columns} FROM {_VERDICTS} WHERE {condition}", values)
