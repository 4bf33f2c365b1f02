"""Queries on the environments of a corpus."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any, NamedTuple

from envcraft.corpus.store.rows import Environment
from envcraft.corpus.store.store import UNDECIDED, Store
from envcraft.model.verdict import Outcome

_COLUMNS = "name, source, class, origin"
#: Each environment with the last verdict on it, which counts only while the source and the class are the same.
_LISTED = (
    "SELECT name, environments.source, environments.class, origin, added, "
    f"verdicts.verdict AS judged, {UNDECIDED.format('verdicts')} AS undecided, steps, seconds, "
    "(SELECT group_concat(code, ' ') FROM (SELECT DISTINCT code FROM findings "
    "WHERE findings.verdict = verdicts.id ORDER BY code)) AS codes "
    "FROM environments LEFT JOIN verdicts ON verdicts.id = environments.verdict "
    "AND verdicts.source = environments.source AND verdicts.class = environments.class"
)
#: The order of :func:`best_first`.
_BEST_FIRST = (
    "SELECT name, environments.source, environments.class FROM environments "
    "LEFT JOIN verdicts ON verdicts.id = environments.verdict AND verdicts.source = environments.source "
    "AND verdicts.class = environments.class "
    "LEFT JOIN findings ON findings.verdict = verdicts.id GROUP BY name ORDER BY "
    "CASE verdicts.verdict WHEN 'pass' THEN 0 WHEN 'fail' THEN 1 WHEN 'error' THEN 2 ELSE 3 END, "
    "coalesce(sum(severity = 'error'), 0), coalesce(sum(severity = 'warning'), 0), added, name"
)


class EnvironmentRow(NamedTuple):
    """An environment, and where it comes from as plain data."""

    environment: Environment
    origin: dict[str, Any]


class Listed(NamedTuple):
    """An environment with the last verdict on its present source.

    `verdict`, `steps` and `seconds` are None if there is no verdict; `undecided` says whether it is a pass with a check
    that left its question open; `codes` are those of the findings, sorted.
    """

    environment: Environment
    origin: dict[str, Any]
    added: str
    verdict: str | None
    undecided: bool
    steps: int | None
    seconds: float | None
    codes: list[str]


def count(store: Store) -> int:
    """The number of environments."""
    found: int = store.db.execute("SELECT count(*) FROM environments").fetchone()[0]
    return found


def names(store: Store) -> list[str]:
    """The names of all environments, sorted."""
    return [name for (name,) in store.db.execute("SELECT name FROM environments ORDER BY name")]


def names_of(store: Store, source: str, env_class: str) -> list[str]:
    """The names of the environments with this source and class, sorted."""
    cursor = store.db.execute(
        "SELECT name FROM environments WHERE source = ? AND class = ? ORDER BY name", (source, env_class)
    )
    return [name for (name,) in cursor]


def every(store: Store) -> list[Environment]:
    """All environments in the order of their names."""
    cursor = store.db.execute("SELECT name, source, class FROM environments ORDER BY name")
    return [Environment(*row) for row in cursor]


def rows(store: Store) -> Iterator[EnvironmentRow]:
    """All environments with their origins, in the order of their names."""
    return map(_row, store.db.execute(f"SELECT {_COLUMNS} FROM environments ORDER BY name"))


def best_first(store: Store) -> list[Environment]:
    """All environments, the best first.

    A pass is better than a fail, which is better than an error, which is better than no verdict; then decide fewer
    errors, fewer warnings, the earlier addition and the name.
    """
    return [Environment(*row) for row in store.db.execute(_BEST_FIRST)]


def distinct(store: Store, pattern: str | None = None) -> list[EnvironmentRow]:
    """The first environment of each source and class, sorted by name.

    Args:
        store: the corpus.
        pattern: a GLOB pattern that names must match; None for all.
    """
    cursor = store.db.execute(
        "SELECT min(name), source, class, origin FROM environments WHERE ?1 IS NULL OR name GLOB ?1 "
        "GROUP BY source, class ORDER BY 1",
        (pattern,),
    )
    return [_row(row) for row in cursor]


def get(store: Store, name: str) -> EnvironmentRow | None:
    """The environment with this name; None if there is none."""
    row = store.db.execute(f"SELECT {_COLUMNS} FROM environments WHERE name = ?", (name,)).fetchone()
    return None if row is None else _row(row)


def with_source(store: Store, sha256: str, name: str) -> Environment | None:
    """An environment with this source, preferably the one with this name; None if there is none."""
    row = store.db.execute(
        "SELECT name, source, class FROM environments WHERE source = ? ORDER BY name = ? DESC LIMIT 1", (sha256, name)
    ).fetchone()
    return None if row is None else Environment(*row)


def listed(
    store: Store, outcome: str | None = None, code: str | None = None, pattern: str | None = None
) -> Iterator[Listed]:
    """Environments with the last verdict on each, in the order of their names.

    Args:
        store: the corpus.
        outcome: only those with this outcome (:class:`envcraft.model.verdict.Outcome`); ``none`` for those without a
            verdict.
        code: only those with a finding of this code.
        pattern: only those whose names match this GLOB pattern.
    """
    conditions, values = ["1"], []
    if outcome == "none":
        conditions.append("judged IS NULL")
    elif outcome == Outcome.UNDECIDED:
        conditions.append("undecided")
    elif outcome is not None:
        conditions.append("judged = ? AND NOT undecided")
        values.append(outcome)
    if code is not None:
        conditions.append("verdicts.id IN (SELECT verdict FROM findings WHERE code = ?)")
        values.append(code)
    if pattern is not None:
        conditions.append("name GLOB ?")
        values.append(pattern)
    return map(_listed, store.db.execute(f"{_LISTED} WHERE {' AND '.join(conditions)} ORDER BY name", values))


def outcomes(store: Store) -> dict[Outcome, int]:
    """The number of environments with each outcome of the last verdict that occurs."""
    cursor = store.db.execute(
        f"SELECT iif(undecided, '{Outcome.UNDECIDED}', judged) AS outcome, count(*) FROM ({_LISTED}) "
        "WHERE judged IS NOT NULL GROUP BY outcome"
    )
    return {Outcome(outcome): number for outcome, number in cursor}


def listing(store: Store, name: str) -> Listed | None:
    """The environment with this name and the last verdict on it; None if there is none."""
    row = store.db.execute(f"{_LISTED} WHERE name = ?", (name,)).fetchone()
    return None if row is None else _listed(row)


def _row(row: tuple[Any, ...]) -> EnvironmentRow:
    *environment, origin = row
    return EnvironmentRow(Environment(*environment), json.loads(origin))


def _listed(row: tuple[Any, ...]) -> Listed:
    name, source, env_class, origin, added, verdict, undecided, steps, seconds, codes = row
    environment = Environment(name, source, env_class)
    judged = (verdict, bool(undecided), steps, seconds)
    return Listed(environment, json.loads(origin), added, *judged, codes.split() if codes else [])
