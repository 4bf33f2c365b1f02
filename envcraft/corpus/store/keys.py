"""Queries on the similarity keys of sources, which can be computed again at any time."""

from __future__ import annotations

from collections.abc import Iterable

from envcraft.corpus.store.store import Store


def stored(store: Store, layer: str, version: int) -> dict[str, bytes | None]:
    """The stored keys of a layer in one version, by the SHA-256 of the source; None for a source without a key."""
    return dict(store.db.execute("SELECT source, key FROM keys WHERE layer = ? AND version = ?", (layer, version)))


def keep(store: Store, keys: Iterable[tuple[str, str, int, bytes | None]]) -> None:
    """Store keys in one transaction, each as source, layer, version and key."""
    with store.transaction():
        store.db.executemany("INSERT OR REPLACE INTO keys (source, layer, version, key) VALUES (?, ?, ?, ?)", keys)
