"""The connection to the SQLite database of a corpus, and the lock that its writer holds."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path

from envcraft.corpus.store import schema
from envcraft.errors import EnvCraftError, UsageError

DATABASE, LOCK = "corpus.sqlite", "lock"
#: Files that an interrupted :func:`create` leaves behind.
UNFINISHED = (f"{DATABASE}.new", f"{DATABASE}.new-journal")
#: Bytes that SQLite needs for the index of its log.
_ROOM = 64 * 1024
#: Errors of SQLite about folders, disks and other processes, not about the content of the database.
_ENVIRONMENT_ERRORS = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}


class CorpusBusy(EnvCraftError):
    """Another process writes to the corpus."""


class CorpusDamaged(EnvCraftError):
    """The corpus differs from what was written to it.

    Args:
        what: what is wrong.
        step: the next step for the user; empty if there is none.
    """

    def __init__(self, what: str, step: str = "") -> None:
        super().__init__(f"{what}; {step}" if step else what)
        self.what = what


def connect(root: Path, write: bool) -> sqlite3.Connection:
    """Open the database of the corpus at `root`.

    Raises:
        sqlite3.Error: if SQLite cannot open it.
    """
    database = root / DATABASE
    db = sqlite3.connect(_uri(database, write), uri=True, isolation_level=None, timeout=30.0)
    try:
        if not write and not _is_readable(db) and not _has_log(database):
            # The index of the log has no room on a full disk. All data is in the database, and a writer has no room.
            db.close()
            db = sqlite3.connect(_uri(database, write, fixed=True), uri=True, isolation_level=None)
        db.execute("PRAGMA foreign_keys = ON")
        if write:
            db.execute("PRAGMA journal_mode = WAL")
            # A power cut may lose the last commits, which are judged again; it never tears the database.
            db.execute("PRAGMA synchronous = NORMAL")
    except BaseException:
        db.close()
        raise
    return db


def _is_readable(db: sqlite3.Connection) -> bool:
    try:
        db.execute("PRAGMA schema_version").fetchone()
    except sqlite3.OperationalError as error:
        return error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_CANTOPEN)
    return True


def _has_log(database: Path) -> bool:
    """Whether the write-ahead log holds what the database does not."""
    log = database.with_name(f"{database.name}-wal")
    return os.path.isfile(log) and os.path.getsize(log) > 0


def _uri(database: Path, write: bool, fixed: bool = False) -> str:
    """The URI of a database; `fixed` says that no process writes to it meanwhile.

    A reader also needs the write-ahead log and its index beside the database. If they are missing and the folder is
    read-only, no process can write, and SQLite opens the database as immutable.
    """
    fixed = fixed or (not os.access(database.parent, os.W_OK) and not _has_log(database))
    options = "mode=rw" if write else "mode=ro&immutable=1" if fixed else "mode=ro"
    return f"{database.absolute().as_uri()}?{options}"


def create(root: Path, folder: bool) -> None:
    """Create the database under another name and rename it when it is complete.

    Args:
        root: the folder of the corpus.
        folder: whether the corpus follows the files of a folder.

    Raises:
        OSError: if a file cannot be written.
        EnvCraftError: if SQLite cannot write the database.
    """
    for name in UNFINISHED:
        (root / name).unlink(missing_ok=True)
    made = root / UNFINISHED[0]
    with translated(root), contextlib.closing(sqlite3.connect(made, isolation_level=None)) as db:
        schema.migrate(db, str(root))
        if folder:
            db.execute("INSERT INTO facts VALUES ('folder', '1')")
    if not (root / DATABASE).is_file():
        made.rename(root / DATABASE)


def lock(root: Path) -> int:
    """Become the writer of the corpus at `root` until the returned descriptor is closed or the process ends.

    Raises:
        CorpusBusy: if another process is the writer.
        UsageError: if the lock file cannot be written.
    """
    try:
        descriptor = os.open(root / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise UsageError(f"cannot write to the corpus {root}: {error.strerror}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        process = f"process {holder}" if holder.isdigit() else "another process"
        raise CorpusBusy(f"{process} is writing to the corpus {root}: wait for it to end, or end it") from None
    # The number is only for the message of another process, so a full disk may leave it out.
    with contextlib.suppress(OSError):
        os.truncate(descriptor, 0)
        os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    return descriptor


@contextlib.contextmanager
def translated(root: Path) -> Iterator[None]:
    """Raise errors of SQLite as EnvCraftError or CorpusDamaged."""
    try:
        yield
    except sqlite3.DatabaseError as error:
        raise translation(root, error) from error


def translation(root: Path, error: sqlite3.Error) -> EnvCraftError:
    """The error to raise in place of an error of SQLite."""
    if getattr(error, "sqlite_errorcode", 0) & 0xFF in _ENVIRONMENT_ERRORS:
        if shutil.disk_usage(root).free < _ROOM:
            return EnvCraftError(f"the disk is full, so the corpus {root} cannot be written; free some space")
        return EnvCraftError(f"cannot read or write the corpus database {root / DATABASE}: {error}")
    return CorpusDamaged(
        f"the corpus database {root / DATABASE} is damaged ({error})",
        f"`envcraft corpus verify {root}` reports the damage",
    )
