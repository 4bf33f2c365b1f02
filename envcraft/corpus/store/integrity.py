"""Queries that check and repair the database itself."""

from __future__ import annotations

import sqlite3
from typing import Any, NamedTuple

from envcraft.corpus.store.store import Store


class Violation(NamedTuple):
    """A row whose foreign key refers to nothing; `row` is None in tables without row numbers."""

    table: str
    row: int | None
    parent: str


def errors(store: Store) -> list[str]:
    """What SQLite reports about a damaged database; empty if it is intact."""
    try:
        found = [" ".join(str(words).split()) for (words,) in store.db.execute("PRAGMA integrity_check(20)")]
    except sqlite3.DatabaseError as error:
        found = [str(error)]
    return [] if found == ["ok"] else found


def reindex(store: Store) -> None:
    """Build the indexes again from the rows."""
    store.db.execute("REINDEX")


def violations(store: Store) -> list[Violation]:
    """The violated foreign keys; one for all rows of a table without row numbers."""
    rows = store.db.execute('SELECT "table", rowid, parent FROM pragma_foreign_key_check').fetchall()
    return list(dict.fromkeys(Violation(*row) for row in rows))


def clear_verdicts(store: Store, table: str, condition: str) -> None:
    """Set the verdict of rows to NULL."""
    store.db.execute(f"UPDATE {table} SET verdict = NULL WHERE {condition}")


def rows(store: Store, table: str, condition: str, values: tuple[Any, ...]) -> list[dict[str, Any]]:
    """Rows of a table that meet a condition, by the names of their columns."""
    cursor = store.db.execute(f"SELECT * FROM {table} WHERE {condition}", values)
    columns = [column[0] for column in cursor.description]
    return [dict(zip(columns, row, strict=True)) for row in cursor]


def delete(store: Store, table: str, condition: str, values: tuple[Any, ...]) -> None:
    """Delete rows of a table that meet a condition."""
    store.db.execute(f"DELETE FROM {table} WHERE {condition}", values)
