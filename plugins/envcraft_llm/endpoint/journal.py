"""What was answered, in a file: nothing is paid for twice, and a run can be repeated from it without an endpoint.

SQLite with a write-ahead log. What `Journal.keep` has returned from is on the disk, and outlives the process and the
machine's power; what was torn is rolled back when the file is next opened. Answers that come in at the same time are
written in one transaction.
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
from envcraft_llm.model import Answer, FailureKind, ModelFailure, Request

#: The name of the file in a corpus.
JOURNAL = "journal.sqlite"
#: Failures that are of the network, not of the request: asked again by a later run with an endpoint.
PASSING: frozenset[FailureKind] = frozenset({"disconnected", "timeout", "server-error", "garbage"})
_SCHEMA = """
CREATE TABLE IF NOT EXISTS answers (
    key TEXT PRIMARY KEY,
    stage TEXT NOT NULL,
    concept TEXT NOT NULL,
    attempt INTEGER NOT NULL,
    model TEXT NOT NULL,
    outcome TEXT NOT NULL,  -- "answer", or the kind of failure
    request BLOB NOT NULL,  -- compressed JSON
    result BLOB NOT NULL,   -- compressed JSON: of the answer, or of the failure's message
    written REAL NOT NULL   -- seconds since 1970
);
PRAGMA user_version = 1;
"""
_VERSION = 1
_WRITE = """
INSERT INTO answers VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)
ON CONFLICT (key) DO UPDATE SET outcome = excluded.outcome, result = excluded.result, written = excluded.written
WHERE answers.outcome != 'answer'
"""
_MERGE = f"{_WRITE.rstrip()} AND excluded.outcome = 'answer'"
#: So many rows are taken over in one transaction.
_ROWS = 500


class Failed(msgspec.Struct, frozen=True):
    """A request that came to nothing."""

    kind: FailureKind
    message: str

    def error(self) -> ModelFailure:
        """As it was raised."""
        return ModelFailure(self.kind, self.message)


Outcome = Answer | Failed
_answer, _message = msgspec.json.Decoder(Answer), msgspec.json.Decoder(str)


class Journal:
    """Outcomes by the keys of requests. Used in one event loop; several processes may write one file.

    Args:
        path: the file, or the folder in which it is called JOURNAL; both are made.
        write: whether it is written to; else it has to exist.

    Raises UsageError where there is none to be read, EnvCraftError where it is no journal or cannot be opened.
    """

    def __init__(self, path: Path, write: bool = True) -> None:
        self.path = path / JOURNAL if path.is_dir() or not path.suffix else path
        if not write and not self.path.is_file():
            raise UsageError(f"{self.path} does not exist: without an endpoint there is nothing to answer from")
        try:
            if write:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            self._writing = _connect(self.path, write) if write else None
            self._reading = _connect(self.path, write=False)
            version = self._reading.execute("PRAGMA user_version").fetchone()[0]
            if version != _VERSION:
                raise EnvCraftError(f"{self.path} is of version {version}, and this EnvCraft reads version {_VERSION}")
            self._reading.execute("SELECT 1 FROM answers LIMIT 1")
        except (OSError, sqlite3.Error) as error:
            raise EnvCraftError(f"{self.path} cannot be used as a journal: {error}") from None
        self._lock = threading.Lock()
        self._pending: list[tuple[Request, Outcome, asyncio.Future[None]]] = []
        self._flushing: asyncio.Task[None] | None = None

    def find(self, key: str, passing: bool = False) -> Outcome | None:
        """What came of the request with this key; with `passing`, failures of the network too."""
        row = self._reading.execute("SELECT outcome, result FROM answers WHERE key = ?", (key,)).fetchone()
        if row is None:
            return None
        outcome, packed = row
        if outcome == "answer":
            return _answer.decode(zlib.decompress(packed))
        if outcome in PASSING and not passing:
            return None
        return Failed(outcome, _message.decode(zlib.decompress(packed)))

    async def keep(self, request: Request, outcome: Outcome) -> None:
        """Write what came of a request; returns once it is safe. An answer that is there already stays."""
        written = asyncio.get_running_loop().create_future()
        self._pending.append((request, outcome, written))
        if self._flushing is None or self._flushing.done():
            self._flushing = asyncio.create_task(self._flush())
        await written

    def keep_now(self, outcomes: list[tuple[Request, Outcome]]) -> None:
        """Write what came of requests, in one transaction. Raises EnvCraftError."""
        self._write(_WRITE, [_row(request, outcome) for request, outcome in outcomes])

    def take(self, other: Journal) -> int:
        """Take over what another journal has, and give how many outcomes came. Of a request that both know, what is
        here stays, unless it failed and was answered there. Raises EnvCraftError; what came before that is kept.
        """
        taken = 0
        try:
            found = other._reading.execute("SELECT * FROM answers ORDER BY key")
            while rows := found.fetchmany(_ROWS):
                taken += self._write(_MERGE, rows)
        except sqlite3.Error as error:
            raise EnvCraftError(f"{other.path} cannot be read as a journal: {error}") from None
        return taken

    def close(self) -> None:
        """Close the file. All `keep` must have returned."""
        self._reading.close()
        if self._writing is not None:
            self._writing.close()

    def _write(self, statement: str, rows: Sequence[tuple[object, ...]]) -> int:
        """Write rows in one transaction; gives how many were added or changed. Raises EnvCraftError."""
        assert self._writing is not None, "opened for reading"
        try:
            with self._lock:
                before = self._writing.total_changes
                self._writing.execute("BEGIN IMMEDIATE")
                try:
                    self._writing.executemany(statement, rows)
                except BaseException:
                    self._writing.execute("ROLLBACK")
                    raise
                self._writing.execute("COMMIT")
                return self._writing.total_changes - before
        except sqlite3.Error as error:
            raise EnvCraftError(f"{self.path} cannot be written: {error}; what it holds is safe") from None

    async def _flush(self) -> None:
        while self._pending:
            batch, self._pending = self._pending, []
            try:
                await asyncio.to_thread(self.keep_now, [(request, outcome) for request, outcome, _ in batch])
            except EnvCraftError as error:
                for _, _, written in batch:
                    if not written.done():
                        written.set_exception(error)
            else:
                for _, _, written in batch:
                    if not written.done():
                        written.set_result(None)


def merge(corpus: Path, other: Path) -> int:
    """Take over the journal of one corpus into that of another, which is made where it lacks; gives how many outcomes
    came. Raises EnvCraftError.
    """
    if not (other / JOURNAL).is_file():
        return 0
    with contextlib.closing(Journal(other, write=False)) as theirs, contextlib.closing(Journal(corpus)) as mine:
        return mine.take(theirs)


def _connect(path: Path, write: bool) -> sqlite3.Connection:
    """Raises sqlite3.Error. Only one thread at a time uses a connection."""
    if write:
        db = sqlite3.connect(path, isolation_level=None, timeout=30.0, check_same_thread=False)
        db.execute("PRAGMA journal_mode = WAL")
        db.execute("PRAGMA synchronous = FULL")
        if not db.execute("PRAGMA user_version").fetchone()[0]:
            db.executescript(_SCHEMA)
        return db
    # Even who only reads needs the log and its index beside the file, unless nobody can be writing there.
    log = path.with_name(f"{path.name}-wal")
    fixed = not os.access(path.parent, os.W_OK) and not (log.is_file() and log.stat().st_size)
    uri = f"{path.absolute().as_uri()}?mode=ro{'&immutable=1' if fixed else ''}"
    return sqlite3.connect(uri, uri=True, isolation_level=None, timeout=30.0, check_same_thread=False)


def _row(request: Request, outcome: Outcome) -> tuple[object, ...]:
    told = outcome.message if isinstance(outcome, Failed) else outcome
    return (
        request.key(),
        request.stage,
        request.concept,
        request.attempt,
        request.model,
        outcome.kind if isinstance(outcome, Failed) else "answer",
        zlib.compress(msgspec.json.encode(request), 1),
        zlib.compress(msgspec.json.encode(told), 1),
        time.time(),
    )
