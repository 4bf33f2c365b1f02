"""Queries on recorded demonstrations and the outcomes of their episodes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from envcraft.corpus.store.store import Store, now

_COLUMNS = "id, source, class, contract, player, seed, steps, file, contract_sha256, player_digest"
_UNUSED = (
    "NOT EXISTS (SELECT 1 FROM environments AS e WHERE e.source = demonstrations.source "
    "AND e.class = demonstrations.class)"
)


class Key(NamedTuple):
    """What identifies a recording."""

    source: str
    env_class: str
    contract_sha256: str
    player: str
    player_digest: str
    seed: int


class Row(NamedTuple):
    """A row of the table of recordings; `file` is the SHA-256 of the recording in hex."""

    number: int
    source: str
    env_class: str
    contract: str
    player: str
    seed: int
    steps: int
    file: str
    contract_sha256: str
    player_digest: str


class EpisodeRow(NamedTuple):
    """An episode of a recording: `total` is its return, `ending` is terminated, truncated or cut."""

    seed: int
    steps: int
    total: float | None
    success: bool | None
    ending: str


class EpisodeOutcome(NamedTuple):
    """The outcome of a complete episode; `success` is None if the environment does not report it."""

    steps: int
    total: float
    success: int | None


def get(store: Store, key: Key) -> Row | None:
    """The recording with this key; None if there is none."""
    row = store.db.execute(
        f"SELECT {_COLUMNS} FROM demonstrations WHERE source = ? AND class = ? AND contract_sha256 = ? "
        "AND player = ? AND player_digest = ? AND seed = ?",
        key,
    ).fetchone()
    return None if row is None else Row(*row)


def named(store: Store, player: str | None = None) -> list[tuple[str, Row]]:
    """The recordings of the corpus's environments, each with its first name, sorted by name and player.

    Args:
        store: the corpus.
        player: only those of this player; None for all.
    """
    columns = ", ".join(f"d.{column}" for column in _COLUMNS.split(", "))
    cursor = store.db.execute(
        f"SELECT min(name), {columns} FROM demonstrations AS d JOIN environments AS e "
        "ON e.source = d.source AND e.class = d.class WHERE ?1 IS NULL OR player = ?1 "
        "GROUP BY d.id ORDER BY 1, player, seed, d.id",
        (player,),
    )
    return [(name, Row(*row)) for name, *row in cursor]


def replace(store: Store, key: Key, contract: str, steps: int, file: str, episodes: Iterable[EpisodeRow]) -> Row | None:
    """Insert a recording in place of the one with the same key.

    Args:
        store: the corpus, open for writing.
        key: what identifies the recording.
        contract: the name of the contract.
        steps: its transitions.
        file: the SHA-256 of the recording in hex.
        episodes: its episodes in order.

    Returns:
        The row that was replaced; None if there was none.
    """
    before = get(store, key)
    with store.transaction():
        if before is not None:
            delete(store, before.number)
        cursor = store.db.execute(
            "INSERT INTO demonstrations (source, class, contract_sha256, player, player_digest, seed, contract, steps, "
            "file, recorded) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (*key, contract, steps, file, now()),
        )
        store.db.executemany(
            "INSERT INTO episodes VALUES (?, ?, ?, ?, ?, ?, ?)",
            [(cursor.lastrowid, number, *episode) for number, episode in enumerate(episodes)],
        )
    return before


def files(store: Store) -> list[tuple[int, str, str]]:
    """The row number, the player and the file's SHA-256 of each recording."""
    return store.db.execute("SELECT id, player, file FROM demonstrations").fetchall()


def delete(store: Store, number: int) -> None:
    """Delete a recording and its episodes."""
    store.db.execute("DELETE FROM demonstrations WHERE id = ?", (number,))


def prune(store: Store) -> list[str]:
    """Delete the recordings of sources and classes that no environment has, and return their files."""
    removed = [file for (file,) in store.db.execute(f"SELECT file FROM demonstrations WHERE {_UNUSED}")]
    store.db.execute(f"DELETE FROM demonstrations WHERE {_UNUSED}")
    return removed


def is_referenced(store: Store, file: str) -> bool:
    """Whether a row refers to a file."""
    return store.db.execute("SELECT 1 FROM demonstrations WHERE file = ? LIMIT 1", (file,)).fetchone() is not None


def outcomes(store: Store) -> Iterator[tuple[str, EpisodeOutcome]]:
    """The player and the outcome of each complete episode, sorted by player.

    Of several versions of a player, only the newest recording of each environment counts.
    """
    cursor = store.db.execute(
        "SELECT player, episodes.steps, total, success FROM episodes JOIN demonstrations AS d "
        "ON d.id = episodes.demonstration WHERE ending != 'cut' AND total IS NOT NULL "
        "AND EXISTS (SELECT 1 FROM environments AS e WHERE e.source = d.source AND e.class = d.class) "
        "AND NOT EXISTS (SELECT 1 FROM demonstrations AS later WHERE later.id > d.id AND later.source = d.source "
        "AND later.class = d.class AND later.contract_sha256 = d.contract_sha256 AND later.player = d.player "
        "AND later.seed = d.seed) ORDER BY player"
    )
    for player, *row in cursor:
        yield player, EpisodeOutcome(*row)


def outcomes_of(store: Store, source: str, env_class: str) -> Iterator[tuple[str, EpisodeOutcome]]:
    """The player and the outcome of each complete episode of an environment, sorted by player, the newest first.

    Args:
        store: the corpus.
        source: the SHA-256 of the environment's source.
        env_class: its class.
    """
    cursor = store.db.execute(
        "SELECT player, episodes.steps, total, success FROM episodes JOIN demonstrations AS d "
        "ON d.id = episodes.demonstration WHERE ending != 'cut' AND total IS NOT NULL AND source = ? AND class = ? "
        "ORDER BY player, d.id DESC, number",
        (source, env_class),
    )
    for player, *row in cursor:
        yield player, EpisodeOutcome(*row)
