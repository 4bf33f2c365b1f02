"""The journal: results of requests in a file, so that nothing is paid for twice and a run can be replayed offline.

The journal is an SQLite database with a write-ahead log and full synchronisation. Once `Journal.put` returns, the
result is on disk and survives the end of the process and a power failure; SQLite rolls an incomplete transaction back.
Results that arrive at the same time share one transaction.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import sqlite3
import threading
import time
import zlib
from collections.abc import Sequence
from pathlib import Path

import msgspec

from envcraft.errors import EnvCraftError, UsageError
from envcraft_llm.model import Completion, FailureKind, Request, RequestFailed

#: The name of the file in a corpus.
JOURNAL = "journal.sqlite"
#: Failures of the network or the endpoint, not of the request; a later run with an endpoint sends the request again.
TRANSIENT: frozenset[FailureKind] = frozenset({"disconnected", "timeout", "server-error", "garbage"})
_SCHEMA = """
CREATE TABLE IF NOT EXISTS answers (
    key TEXT PRIMARY KEY,
    stage TEXT NOT NULL,
    concept TEXT NOT NULL,
    attempt INTEGER NOT NULL,
    model TEXT NOT NULL,
    outcome TEXT NOT NULL,  -- "answer", or the kind of failure
    request BLOB NOT NULL,  -- compressed JSON
    result BLOB NOT NULL,   -- compressed JSON: of the completion, or of the failure's message
    written REAL NOT NULL   -- seconds since 1970
);
PRAGMA user_version = 1;
"""
_VERSION = 1
_PUT = """
INSERT INTO answers VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)
ON CONFLICT (key) DO UPDATE SET outcome = excluded.outcome, result = excluded.result, written = excluded.written
WHERE answers.outcome != 'answer'
"""
_MERGE = f"{_PUT.rstrip()} AND excluded.outcome = 'answer'"
#: Rows that a merge copies in one transaction.
_ROWS = 500


class Failure(msgspec.Struct, frozen=True):
    """The result of a request that failed."""

    kind: FailureKind
    message: str

    def error(self) -> RequestFailed:
        """Return the exception."""
        return RequestFailed(self.kind, self.message)


Result = Completion | Failure
_completion, _message = msgspec.json.Decoder(Completion), msgspec.json.Decoder(str)


class Journal:
    """Results by the keys of requests. Used in one event loop; several processes may write one file.

    Args:
        path: The file, or the folder that holds it as `JOURNAL`. Both are created if `write` is true.
        write: Whether results will be written. Otherwise the file has to exist.

    Raises:
        UsageError: If there is no journal to read.
        EnvCraftError: If the file is not a journal or cannot be opened.
    """

    def __init__(self, path: Path, write: bool = True) -> None:
        self.path = path / JOURNAL if path.is_dir() or not path.suffix else path
        if not write and not self.path.is_file():
            raise UsageError(f"{self.path} does not exist: without an endpoint, completions come from a journal")
        try:
            if write:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = _connect(self.path, write) if write else None
            self._reader = _connect(self.path, write=False)
            version = self._reader.execute("PRAGMA user_version").fetchone()[0]
            if version != _VERSION:
                raise EnvCraftError(
                    f"{self.path} has version {version}, and this version of EnvCraft reads version {_VERSION}"
                )
            self._reader.execute("SELECT 1 FROM answers LIMIT 1")
        except (OSError, sqlite3.Error) as error:
            raise EnvCraftError(f"{self.path} cannot be used as a journal: {error}") from None
        self._lock = threading.Lock()
        self._pending: list[tuple[Request, Result, asyncio.Future[None]]] = []
        self._flushing: asyncio.Task[None] | None = None

    def get(self, key: str, transient: bool = False) -> Result | None:
        """Return the result of the request with this key, or None.

        Args:
            key: Key of the request.
            transient: Whether to return transient failures too.
        """
        row = self._reader.execute("SELECT outcome, result FROM answers WHERE key = ?", (key,)).fetchone()
        if row is None:
            return None
        outcome, packed = row
        if outcome == "answer":
            return _completion.decode(zlib.decompress(packed))
        if outcome in TRANSIENT and not transient:
            return None
        return Failure(outcome, _message.decode(zlib.decompress(packed)))

    async def put(self, request: Request, result: Result) -> None:
        """Write a result, and return once it is on disk. An existing completion stays. Raises EnvCraftError."""
        written = asyncio.get_running_loop().create_future()
        self._pending.append((request, result, written))
        if self._flushing is None or self._flushing.done():
            self._flushing = asyncio.create_task(self._flush())
        await written

    def put_all(self, results: list[tuple[Request, Result]]) -> None:
        """Write results in one transaction. Raises EnvCraftError."""
        self._write(_PUT, [_row(request, result) for request, result in results])

    def merge(self, other: Journal) -> int:
        """Copy results from another journal and return how many were added or replaced.

        An existing result stays, unless it is a failure and the other journal has a completion. Raises EnvCraftError;
        what was copied before stays.
        """
        count = 0
        try:
            found = other._reader.execute("SELECT * FROM answers ORDER BY key")
            while rows := found.fetchmany(_ROWS):
                count += self._write(_MERGE, rows)
        except sqlite3.Error as error:
            raise EnvCraftError(f"{other.path} cannot be read as a journal: {error}") from None
        return count

    def close(self) -> None:
        """Close the file. Every call of `put` must have returned."""
        self._reader.close()
        if self._writer is not None:
            self._writer.close()

    def _write(self, statement: str, rows: Sequence[tuple[object, ...]]) -> int:
        """Write rows in one transaction and return how many were added or changed. Raises EnvCraftError."""
        assert self._writer is not None, "the journal is open for reading only"
        try:
            with self._lock:
                before = self._writer.total_changes
                self._writer.execute("BEGIN IMMEDIATE")
                try:
                    self._writer.executemany(statement, rows)
                except BaseException:
                    self._writer.execute("ROLLBACK")
                    raise
                self._writer.execute("COMMIT")
                return self._writer.total_changes - before
        except sqlite3.Error as error:
            raise EnvCraftError(f"{self.path} cannot be written: {error}; its content is intact") from None

    async def _flush(self) -> None:
        while self._pending:
            batch, self._pending = self._pending, []
            try:
                await asyncio.to_thread(self.put_all, [(request, result) for request, result, _ in batch])
            except EnvCraftError as error:
                for _, _, written in batch:
                    if not written.done():
                        written.set_exception(error)
            else:
                for _, _, written in batch:
                    if not written.done():
                        written.set_result(None)


def merge(corpus: Path, other: Path) -> int:
    """Copy the journal of another corpus into that of `corpus`, which is created if it does not exist.

    Returns:
        The number of results that were added or replaced.

    Raises:
        EnvCraftError: If a journal cannot be read or written.
    """
    if not (other / JOURNAL).is_file():
        return 0
    with contextlib.closing(Journal(other, write=False)) as source, contextlib.closing(Journal(corpus)) as target:
        return target.merge(source)


def _connect(path: Path, write: bool) -> sqlite3.Connection:
    """Raises sqlite3.Error. One thread at a time uses a connection."""
    if write:
        db = sqlite3.connect(path, isolation_level=None, timeout=30.0, check_same_thread=False)
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        if not db.execute("PRAGMA user_version").fetchone()[0]:
            db.executescript(_SCHEMA)
        return db
    # A reader needs the log and its index beside the file, unless the folder is read-only and the log is empty.
    log = path.with_name(f"{path.name}-wal")
    immutable = not os.access(path.parent, os.W_OK) and not (log.is_file() and log.stat().st_size)
    uri = f"{path.absolute().as_uri()}?mode=ro{'&immutable=1' if immutable else ''}"
    return sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30.0, check_same_thread=False)


def _row(request: Request, result: Result) -> tuple[object, ...]:
    content = result.message if isinstance(result, Failure) else result
    return (
        request.key(),
        request.stage,
        request.concept,
        request.attempt,
        request.model,
        result.kind if isinstance(result, Failure) else "answer",
        zlib.compress(msgspec.json.encode(request), 1),
        zlib.compress(msgspec.json.encode(content), 1),
        time.time(),
    )
