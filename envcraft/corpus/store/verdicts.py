"""Queries on verdicts, their settings and their findings."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

from envcraft.corpus.store.rows import Environment
from envcraft.corpus.store.store import UNSETTLED, Store
from envcraft.judging.settings import Settings
from envcraft.model.verdict import Verdict

_SETTINGS = "contract, contract_sha256, rules, seed, budget, driver, image, settings.checks, offered"
#: The condition that the source and class of a verdict failed the same checks in the same version, or some of them
#: alone, under the same contract.
_FAILED = (
    "EXISTS (SELECT 1 FROM verdicts AS v JOIN settings AS s ON s.id = v.settings WHERE v.source = verdicts.source "
    "AND v.class = verdicts.class AND v.verdict = 'fail' AND s.contract_sha256 = settings.contract_sha256 "
    "AND settings.rules IN (s.rules, s.offered))"
)
#: The condition that a verdict is a pass of all checks that no other budget or seed contradicts.
_PASSED = (
    f"(verdicts.verdict = 'pass' AND settings.checks = '' AND NOT {UNSETTLED.format('verdicts')} AND NOT {_FAILED})"
)


class Last(NamedTuple):
    """An environment with the last verdict on its present source.

    Attributes:
        environment: the environment.
        origin: where it comes from, as plain data.
        added: when it was added.
        verdict: the verdict; None, as all that follows, if there is none.
        report: the verdict as JSON.
        number: the row number of the settings.
        settings: how it was judged.
    """

    environment: Environment
    origin: dict[str, Any]
    added: str
    verdict: str | None
    report: str | None
    number: int | None
    settings: Settings | None


class Given(NamedTuple):
    """A verdict on a source.

    Attributes:
        settings: how it was judged.
        verdict: the verdict.
        failed: whether the source failed the same checks, or some of them alone, with another budget or seed.
        settled: whether neither an error nor the clock decided.
        report: the verdict as JSON.
    """

    settings: Settings
    verdict: Verdict
    failed: bool
    settled: bool
    report: str


class Row(NamedTuple):
    """A row of the table of verdicts; `settings` is the row number of the settings."""

    number: int
    source: str
    env_class: str
    settings: int
    verdict: str
    steps: int
    report: str


def last(store: Store, passed: bool = False) -> Iterator[Last]:
    """All environments with the last verdict on each, in the order of their names.

    Args:
        store: the corpus.
        passed: only those with a pass that counts (:mod:`envcraft.corpus.trust`).
    """
    cursor = store.db.execute(
        "SELECT name, environments.source, environments.class, origin, added, verdicts.verdict, report, settings.id, "
        f"{_SETTINGS} FROM environments "
        "LEFT JOIN verdicts ON verdicts.id = environments.verdict AND verdicts.source = environments.source "
        "AND verdicts.class = environments.class LEFT JOIN settings ON settings.id = verdicts.settings "
        f"WHERE {_PASSED if passed else '1'} ORDER BY name"
    )
    for name, source, env_class, origin, added, verdict, report, number, *settings in cursor:
        yield Last(
            Environment(name, source, env_class),
            json.loads(origin),
            added,
            verdict,
            report,
            number,
            None if number is None else Settings(*settings),
        )


def given(store: Store, source: str, env_class: str) -> Iterator[Given]:
    """The verdicts on a source and class, the last one first, then the newest first; errors included."""
    cursor = store.db.execute(
        f"SELECT {_SETTINGS}, verdict, {_FAILED}, NOT {UNSETTLED.format('verdicts')}, report "
        "FROM verdicts JOIN settings ON settings.id = verdicts.settings WHERE source = ?1 AND class = ?2 "
        # The environment's own is the last one, even if an older row was written again.
        "ORDER BY verdicts.id IN (SELECT verdict FROM environments WHERE source = ?1 AND class = ?2) DESC, "
        "verdicts.id DESC",
        (source, env_class),
    )
    for *settings, verdict, failed, settled, report in cursor:
        yield Given(Settings(*settings), Verdict(verdict), bool(failed), bool(settled), report)


def of_source(store: Store, source: str, env_class: str) -> list[tuple[Settings, str]]:
    """The settings and the report as JSON of each verdict on a source and class, the oldest first."""
    cursor = store.db.execute(
        f"SELECT {_SETTINGS}, report FROM verdicts JOIN settings ON settings.id = verdicts.settings "
        "WHERE source = ? AND class = ? ORDER BY verdicts.id",
        (source, env_class),
    )
    return [(Settings(*settings), report) for *settings, report in cursor]


def reports(store: Store) -> Iterator[tuple[str, str, str]]:
    """The source, class and report as JSON of each verdict, in the order of their row numbers."""
    return store.db.execute("SELECT source, class, report FROM verdicts ORDER BY id")


def rows(store: Store) -> Iterator[Row]:
    """All verdicts in the order of their row numbers; rows may be written meanwhile."""
    for (number,) in store.db.execute("SELECT id FROM verdicts ORDER BY id").fetchall():
        row = get(store, number)
        if row is not None:
            yield row


def get(store: Store, number: int | None) -> Row | None:
    """The verdict with this row number; None if there is none."""
    row = store.db.execute(
        "SELECT id, source, class, settings, verdict, steps, report FROM verdicts WHERE id = ?", (number,)
    ).fetchone()
    return None if row is None else Row(*row)


def under(store: Store, source: str, env_class: str, settings: int) -> tuple[int, Verdict] | None:
    """The row number and the verdict on a source and class under settings; None if there is none."""
    row = store.db.execute(
        "SELECT id, verdict FROM verdicts WHERE source = ? AND class = ? AND settings = ?",
        (source, env_class, settings),
    ).fetchone()
    return None if row is None else (row[0], Verdict(row[1]))


def findings(store: Store, verdict: int) -> list[tuple[Any, ...]]:
    """The finding rows of a verdict in order, as :func:`envcraft.corpus.store.rows.finding_rows` gives them."""
    cursor = store.db.execute(
        "SELECT rule_check, code, severity, line, message FROM findings WHERE verdict = ? ORDER BY number", (verdict,)
    )
    return cursor.fetchall()


def rewrite(store: Store, number: int, verdict: str, steps: int, seconds: float) -> None:
    """Replace the columns of a verdict that repeat its report."""
    store.db.execute(
        "UPDATE verdicts SET verdict = ?, steps = ?, seconds = ? WHERE id = ?", (verdict, steps, seconds, number)
    )


def codes(store: Store) -> set[str]:
    """The codes of all findings."""
    return {code for (code,) in store.db.execute("SELECT DISTINCT code FROM findings")}


def contracts(store: Store) -> dict[str, int]:
    """The number of last verdicts under each contract, the most frequent contract first."""
    cursor = store.db.execute(
        "SELECT contract, count(*) FROM environments JOIN verdicts ON verdicts.id = environments.verdict "
        "JOIN settings ON settings.id = verdicts.settings GROUP BY contract ORDER BY count(*) DESC, contract"
    )
    return dict(cursor.fetchall())


def all_settings(store: Store) -> dict[int, Settings]:
    """All settings by their row numbers."""
    cursor = store.db.execute(f"SELECT id, {_SETTINGS} FROM settings ORDER BY id")
    return {number: Settings(*settings) for number, *settings in cursor}


def last_rows(store: Store) -> Iterator[tuple[str, str, str, str, int]]:
    """For each environment with a last verdict: its source and class, and source, class and settings of the verdict.

    Verdicts on the present source and class come first.
    """
    return store.db.execute(
        "SELECT e.source, e.class, v.source, v.class, v.settings FROM environments AS e JOIN verdicts AS v "
        "ON v.id = e.verdict ORDER BY v.source = e.source AND v.class = e.class DESC, e.name"
    )


def set_missing_last(store: Store, source: str, env_class: str, judged: tuple[str, str], settings: int) -> None:
    """Set the last verdict of environments that have none.

    Args:
        store: the corpus, open for writing.
        source: the source of the environments.
        env_class: their class.
        judged: the source and class of the verdict.
        settings: the row number of its settings.
    """
    store.db.execute(
        "UPDATE environments SET verdict = (SELECT id FROM verdicts AS v WHERE v.source = ? AND v.class = ? "
        "AND v.settings = ?) WHERE source = ? AND class = ? AND verdict IS NULL",
        (*judged, settings, source, env_class),
    )
