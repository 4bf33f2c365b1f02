"""The folder that a corpus is: ``corpus.sqlite`` for all that is asked for, ``sources`` with a file for each digest.

One process writes at a time, and holds ``lock`` for as long as it lives; any number may read meanwhile. A source is on
disk before a row names it, so that whatever ends the process leaves at the most a file that no row names.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import json
import os
import sqlite3
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import msgspec

from envcraft.corpus import schema
from envcraft.corpus.settings import Settings
from envcraft.errors import EnvCraftError, UsageError
from envcraft.verdict import SubjectReport, Verdict, plain

DATABASE, SOURCES, LOCK = "corpus.sqlite", "sources", "lock"
#: Where the corpus of a plain folder lies, in that folder.
BESIDE = ".envcraft"
#: What SQLite says of folders, disks and other processes, not of the database.
_ELSEWHERE = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}
#: Of environments, that a verdict under some settings may be the last on them: it is of all checks, or there is none of
#: all on what they are now.
LEADS = """(
    EXISTS (SELECT 1 FROM settings WHERE id = ? AND checks = '') OR NOT EXISTS (
        SELECT 1 FROM verdicts AS whole JOIN settings ON settings.id = whole.settings AND settings.checks = ''
        WHERE whole.id = environments.verdict
        AND whole.source = environments.source AND whole.class = environments.class))"""
_UNFINISHED = (f"{DATABASE}.new", f"{DATABASE}.new-journal")


class CorpusBusy(EnvCraftError):
    """Another process writes to the corpus."""


class CorpusDamaged(EnvCraftError):
    """The corpus is not what it was when it was written: `what` is wrong, and the next step, if there is one."""

    def __init__(self, what: str, step: str = "") -> None:
        super().__init__(f"{what}; {step}" if step else what)
        self.what = what


class Environment(NamedTuple):
    """A row of the table: `source` is a SHA-256 in hex, `env_class` empty unless the file has several."""

    name: str
    source: str
    env_class: str


class Store:
    """An open corpus; use it as a context manager. Methods that write need ``write=True``.

    Methods raise CorpusDamaged where the database or a source is not what it was.
    """

    def __init__(self, root: Path, write: bool = False) -> None:
        """Open the corpus at `root`, or that of a folder. Raises UsageError, CorpusBusy, CorpusDamaged."""
        self.root = find(root)
        self._left: set[str] = set()
        self._lock = _lock(self.root) if write else None
        try:
            with _told(self.root):
                self.db = _connect(self.root / DATABASE, write)
                found = schema.version(self.db, str(self.root))
                if not found:
                    # One gets its name when it is complete.
                    raise CorpusDamaged(
                        f"the corpus database {self.root / DATABASE} is empty, or no corpus's",
                        f"`envcraft corpus verify {self.root}` tells more",
                    )
                if found < len(schema.MIGRATIONS):
                    if self._lock is None:
                        self._lock = _lock(self.root)
                        self.db.close()
                        self.db = _connect(self.root / DATABASE, write=True)
                    schema.migrate(self.db, str(self.root))
            if self._lock is not None:
                # Whoever was writing these is gone.
                for stray in (self.root / "tmp").glob("*"):
                    stray.unlink(missing_ok=True)
        except BaseException:
            self.close()
            raise

    @classmethod
    def create(cls, root: Path, folder: bool = False) -> Store:
        """Make a corpus at `root`, and open it for writing: with `folder`, for the files of a folder, which it follows.
        Raises UsageError where there is one, or something else.
        """
        try:
            root.mkdir(parents=True, exist_ok=True)
            if is_corpus(root):
                raise UsageError(f"{root} is a corpus already")
            # What was begun and ended in between is begun again.
            if {path.name for path in root.iterdir()} - {SOURCES, "tmp", LOCK, ".gitignore", *_UNFINISHED}:
                raise UsageError(f"{root} is not empty; name a folder that is new or empty")
            lock = _lock(root)
            try:
                for part in (SOURCES, "tmp"):
                    (root / part).mkdir(exist_ok=True)
                if folder:
                    # It lies among somebody's sources, and is none.
                    (root / ".gitignore").write_text("*\n", "utf-8")
                _make_database(root, folder)
            finally:
                os.close(lock)
        except OSError as error:
            raise UsageError(f"the corpus {root} cannot be made: {error.strerror or error}") from None
        return cls(root, write=True)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
        if isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.ProgrammingError):
            raise _unusable(self.root, error) from error

    def close(self) -> None:
        """Close the database, and let others write."""
        if "db" in vars(self):
            self.db.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """All that is written inside, or nothing."""
        self.db.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self.db.execute("ROLLBACK")
            raise
        self.db.execute("COMMIT")

    @property
    def writes(self) -> bool:
        """Whether the corpus was opened for writing."""
        return self._lock is not None

    @property
    def follows_folder(self) -> bool:
        """Whether the corpus is that of a folder's files, rather than one that environments are added to."""
        return self.db.execute("SELECT 1 FROM facts WHERE name = 'folder'").fetchone() is not None

    # Sources

    def place(self, sha256: str) -> Path:
        """Where a source lies, or would."""
        return self.root / SOURCES / sha256[:2] / sha256[2:4] / f"{sha256}.py"

    def put(self, data: bytes) -> str:
        """Keep a source, whole or not at all; give its SHA-256. Raises OSError."""
        sha256 = hashlib.sha256(data).hexdigest()
        place = self.place(sha256)
        if not place.exists():
            self.keep(place, data)
        return sha256

    def keep(self, place: Path, data: bytes) -> None:
        """Write a file of the corpus, whole or not at all. Raises OSError."""
        (self.root / "tmp").mkdir(exist_ok=True)
        place.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(dir=self.root / "tmp")
        try:
            with open(descriptor, "wb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, place)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise
        _sync(place.parent)

    def source(self, sha256: str) -> bytes:
        """A source. Raises CorpusDamaged where it is gone or has changed."""
        try:
            data = self.place(sha256).read_bytes()
        except OSError as error:
            raise CorpusDamaged(
                f"the source {self.place(sha256)} cannot be read ({error.strerror})",
                f"`envcraft corpus verify {self.root} --repair` removes what names it",
            ) from None
        if hashlib.sha256(data).hexdigest() != sha256:
            raise CorpusDamaged(
                f"the source {self.place(sha256)} has changed",
                f"`envcraft corpus verify {self.root} --repair` sets it aside",
            )
        return data

    # Environments

    def describe(self, name: str, origin: dict[str, Any]) -> None:
        """Say anew where an environment comes from."""
        told = json.dumps(plain(origin), sort_keys=True)
        self.db.execute("UPDATE environments SET origin = ? WHERE name = ?", (told, name))

    def add(self, name: str, data: bytes, env_class: str = "", origin: dict[str, Any] | None = None) -> bool:
        """Add an environment, or put another source in the place of its own; give whether anything is different.
        Raises OSError.
        """
        sha256 = self.put(data)
        known = self.db.execute("SELECT source, class FROM environments WHERE name = ?", (name,)).fetchone()
        if known == (sha256, env_class):
            return False
        if known is not None:
            self.leave(known[0])
        self.db.execute(
            "INSERT INTO environments (name, source, class, origin, added, changed) "
            "VALUES (?, ?, ?, ?, ?, 1 + coalesce((SELECT max(id) FROM audits), 0)) "
            "ON CONFLICT (name) DO UPDATE SET source = excluded.source, class = excluded.class, "
            "origin = excluded.origin, changed = excluded.changed",
            (name, sha256, env_class, json.dumps(plain(origin or {}), sort_keys=True), now()),
        )
        return True

    def leave(self, sha256: str) -> None:
        """Remember that an environment has this source no longer."""
        self._left.add(sha256)

    def prune(self) -> None:
        """Delete the sources that were left and that no row names any more; not within a transaction, which may yet
        be taken back.
        """
        for sha256 in self._left:
            if not self.named(sha256):
                self.place(sha256).unlink(missing_ok=True)
                self.db.execute("DELETE FROM keys WHERE source = ?", (sha256,))
        self._left.clear()

    def named(self, sha256: str) -> bool:
        """Whether an environment, a verdict or an attempt at one names a source."""
        query = "SELECT 1 FROM {} WHERE source = ? LIMIT 1"
        tables = ("environments", "verdicts", "attempts")
        return any(self.db.execute(query.format(table), (sha256,)).fetchone() is not None for table in tables)

    def twins(self, data: bytes, env_class: str = "") -> list[str]:
        """The names of environments with this source."""
        sha256 = hashlib.sha256(data).hexdigest()
        found = self.db.execute(
            "SELECT name FROM environments WHERE source = ? AND class = ? ORDER BY name", (sha256, env_class)
        )
        return [name for (name,) in found]

    def remove(self, name: str) -> bool:
        """Remove an environment, and its source and verdicts unless another one has the same; give whether there was
        one.
        """
        row = self.db.execute("SELECT source FROM environments WHERE name = ?", (name,)).fetchone()
        if row is None:
            return False
        with self.transaction():
            self.db.execute("DELETE FROM environments WHERE name = ?", (name,))
            if self.db.execute("SELECT 1 FROM environments WHERE source = ?", row).fetchone() is None:
                self.db.execute("DELETE FROM verdicts WHERE source = ?", row)
        self.leave(row[0])
        self.prune()
        return True

    # Verdicts

    def settings(self, settings: Settings) -> int:
        """The number of a way to judge, which is written down if it is new."""
        row = (settings.digest, *msgspec.structs.astuple(settings))
        self.db.execute(
            "INSERT INTO settings "
            "(digest, contract, contract_sha256, rules, seed, budget, driver, image, checks, offered) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) "
            "ON CONFLICT (digest) DO UPDATE SET checks = excluded.checks, offered = excluded.offered "
            # What was all of them may be some by now, and the other way round.
            "WHERE excluded.checks != '?'",
            row,
        )
        found: int = self.db.execute("SELECT id FROM settings WHERE digest = ?", row[:1]).fetchone()[0]
        return found

    def record(self, environment: Environment, settings: int, report: SubjectReport) -> bool:
        """Write a verdict down, in place of one that there was, for every environment with this source; give whether
        it was: what could not be judged takes no verdict's place.

        It is the last verdict on these environments, unless it is of some checks alone and there is one of all.
        """
        report = msgspec.structs.replace(report, path=environment.name)
        with self.transaction():
            verdict = self.insert(environment.source, environment.env_class, settings, report)
            stands: str = self.db.execute("SELECT verdict FROM verdicts WHERE id = ?", (verdict,)).fetchone()[0]
            self.db.execute(
                f"UPDATE environments SET verdict = ? WHERE source = ? AND class = ? AND {LEADS}",
                (verdict, environment.source, environment.env_class, settings),
            )
        return bool(stands == report.verdict.value)

    def insert(self, source: str, env_class: str, settings: int, report: SubjectReport) -> int:
        """Write a verdict's rows within a transaction, unless they would be an error in place of a verdict that stands;
        give the number.
        """
        key = (source, env_class, settings)
        text = msgspec.json.encode(plain(report)).decode()
        cursor = self.db.execute(
            "INSERT INTO verdicts (source, class, settings, verdict, steps, seconds, report) "
            "VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (source, class, settings) DO UPDATE SET "
            "verdict = excluded.verdict, steps = excluded.steps, seconds = excluded.seconds, report = excluded.report "
            "WHERE excluded.verdict != 'error' OR verdicts.verdict = 'error'",
            (*key, report.verdict.value, report.steps, report.seconds, text),
        )
        verdict: int = self.db.execute(
            "SELECT id FROM verdicts WHERE source = ? AND class = ? AND settings = ?", key
        ).fetchone()[0]
        if cursor.rowcount > 0:
            self.write_findings(verdict, report)
        return verdict

    def write_findings(self, verdict: int, report: SubjectReport) -> None:
        """Make the rows of a verdict's findings those of its report."""
        self.db.execute("DELETE FROM findings WHERE verdict = ?", (verdict,))
        self.db.executemany(
            "INSERT INTO findings VALUES (?, ?, ?, ?, ?, ?, ?)",
            [(verdict, number, *row) for number, row in enumerate(finding_rows(report), 1)],
        )


def opened(root: Path, write: bool = False) -> Store:
    """The corpus: for writing if that can be, so that what sources are compared by is kept, and where it must be.
    Raises UsageError, CorpusBusy, CorpusDamaged.
    """
    try:
        return Store(root, write=True)
    except (CorpusBusy, UsageError):
        if write:
            raise
        return Store(root)


def finding_rows(report: SubjectReport) -> Iterator[tuple[Any, ...]]:
    """The findings of a report as the table has them, in order, without verdict and number."""
    for check in report.checks:
        for finding in check.findings:
            told = plain([check.check, finding.code, finding.severity, finding.line, finding.message])
            yield tuple(told)


def decode(report: str) -> SubjectReport:
    """A report as the table has it. Raises msgspec.DecodeError."""
    return msgspec.json.decode(report, type=SubjectReport)


def settled(verdict: str) -> bool:
    """Whether a verdict stands: what could not be judged is tried again."""
    return verdict != Verdict.ERROR


def now() -> str:
    """The time in UTC, to the second, as ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def is_corpus(root: Path) -> bool:
    # Where one may not look, there is none to be used.
    return os.path.isfile(root / DATABASE)


def find(root: Path) -> Path:
    """The corpus at a path, or that of the folder there. Raises UsageError."""
    for place in (root, root / BESIDE):
        if is_corpus(place):
            return place
    raise UsageError(
        f"{root} is no corpus; `envcraft corpus init {root}` makes one, and `envcraft audit FOLDER` that of a folder"
    )


def _connect(database: Path, write: bool) -> sqlite3.Connection:
    """Raises sqlite3.Error."""
    db = sqlite3.connect(_uri(database, write), uri=True, isolation_level=None, timeout=30.0)
    try:
        db.execute("PRAGMA foreign_keys = ON")
        if write:
            db.execute("PRAGMA journal_mode = WAL")
            # A commit that a power cut loses is judged again; nothing is torn.
            db.execute("PRAGMA synchronous = NORMAL")
    except BaseException:
        db.close()
        raise
    return db


def _uri(database: Path, write: bool) -> str:
    """How SQLite opens a database. Even who only reads needs the log and the index of it beside the database; where
    these are not there and cannot be made, nobody can be writing, and none is needed.
    """
    log = database.with_name(f"{database.name}-wal")
    fixed = not os.access(database.parent, os.W_OK) and not (os.path.isfile(log) and os.path.getsize(log))
    options = "mode=rw" if write else "mode=ro&immutable=1" if fixed else "mode=ro"
    return f"{database.absolute().as_uri()}?{options}"


def _make_database(root: Path, folder: bool) -> None:
    """Make the database whole before it has its name. Raises OSError."""
    for name in _UNFINISHED:
        (root / name).unlink(missing_ok=True)
    made = root / _UNFINISHED[0]
    with _told(root), contextlib.closing(sqlite3.connect(made, isolation_level=None)) as db:
        schema.migrate(db, str(root))
        if folder:
            db.execute("INSERT INTO facts VALUES ('folder', '1')")
    if not is_corpus(root):
        os.replace(made, root / DATABASE)


def _lock(root: Path) -> int:
    """Become the one that writes, until the descriptor is closed or the process ends. Raises CorpusBusy, UsageError."""
    try:
        descriptor = os.open(root / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise UsageError(f"the corpus {root} cannot be written to: {error.strerror}") from None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        holder = os.pread(descriptor, 20, 0).decode("ascii", "replace").strip()
        os.close(descriptor)
        words = f"process {holder}" if holder.isdigit() else "another process"
        raise CorpusBusy(f"{words} is writing to the corpus {root}: wait until it has ended, or end it") from None
    os.truncate(descriptor, 0)
    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
    return descriptor


@contextlib.contextmanager
def _told(root: Path) -> Iterator[None]:
    try:
        yield
    except sqlite3.DatabaseError as error:
        raise _unusable(root, error) from error


def _unusable(root: Path, error: sqlite3.Error) -> EnvCraftError:
    if getattr(error, "sqlite_errorcode", 0) & 0xFF in _ELSEWHERE:
        return EnvCraftError(f"the corpus database {root / DATABASE} cannot be read or written here: {error}")
    return CorpusDamaged(
        f"the corpus database {root / DATABASE} cannot be used ({error})",
        f"`envcraft corpus verify {root}` tells more",
    )


def _sync(folder: Path) -> None:
    """Make a folder's entries last."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
