"""Queries on the previews of environments: which media file belongs to which source and class."""

from __future__ import annotations

from envcraft.corpus.store.rows import Environment
from envcraft.corpus.store.store import Store


def media(store: Store, environment: Environment) -> str | None:
    """The SHA-256 of the preview of an environment; None if there is none."""
    row = store.db.execute(
        "SELECT media FROM previews WHERE source = ? AND class = ?", (environment.source, environment.env_class)
    ).fetchone()
    return None if row is None else row[0]


def pending(store: Store, recipe: str, contract: str, default: str) -> list[Environment]:
    """The environments without a preview by a recipe, one for each source and class, sorted by name.

    Environments that the check `source` refused are left out.

    Args:
        store: the corpus.
        recipe: how previews are made.
        contract: only environments whose last verdict is under the contract with this name.
        default: the name of the contract that environments without a verdict count under.
    """
    cursor = store.db.execute(
        "SELECT min(name), source, class FROM environments LEFT JOIN previews USING (source, class) "
        "WHERE recipe IS NOT ? AND coalesce(verdict, 0) NOT IN "
        "(SELECT verdict FROM findings WHERE rule_check = 'source' AND severity = 'error') "
        "AND coalesce((SELECT contract FROM verdicts JOIN settings ON settings.id = verdicts.settings "
        "WHERE verdicts.id = environments.verdict), ?) = ? GROUP BY source, class ORDER BY 1",
        (recipe, default, contract),
    )
    return [Environment(*row) for row in cursor]


def record(store: Store, environment: Environment, recipe: str, sha256: str | None) -> None:
    """Set the preview of an environment: the SHA-256 of the file, or None if it shows no picture."""
    store.db.execute(
        "INSERT OR REPLACE INTO previews VALUES (?, ?, ?, ?)",
        (environment.source, environment.env_class, recipe, sha256),
    )


def prune(store: Store) -> None:
    """Delete the rows of sources and classes that no environment has."""
    store.db.execute(
        "DELETE FROM previews WHERE NOT EXISTS (SELECT 1 FROM environments "
        "WHERE environments.source = previews.source AND environments.class = previews.class)"
    )


def is_referenced(store: Store, sha256: str) -> bool:
    """Whether a row refers to a media file."""
    return store.db.execute("SELECT 1 FROM previews WHERE media = ? LIMIT 1", (sha256,)).fetchone() is not None


def rows(store: Store) -> list[tuple[str, str]]:
    """The source and the SHA-256 of the media file of each row that has one."""
    return store.db.execute("SELECT source, media FROM previews WHERE media IS NOT NULL").fetchall()


def forget(store: Store, sha256: str) -> None:
    """Delete the rows that refer to a media file."""
    store.db.execute("DELETE FROM previews WHERE media = ?", (sha256,))
