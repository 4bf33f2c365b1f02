"""The store of a corpus: its folder and SQLite database, and a module for each kind of query."""

from envcraft.corpus.store.database import DATABASE, CorpusBusy, CorpusDamaged
from envcraft.corpus.store.rows import Environment, decode
from envcraft.corpus.store.store import (
    FOLDER_CORPUS,
    SOURCES,
    Store,
    find,
    is_corpus,
    now,
    open_store,
)

__all__ = [
    "DATABASE",
    "FOLDER_CORPUS",
    "SOURCES",
    "CorpusBusy",
    "CorpusDamaged",
    "Environment",
    "Store",
    "decode",
    "find",
    "is_corpus",
    "now",
    "open_store",
]
