"""The folder of a corpus: ``corpus.sqlite`` holds the tables, ``sources`` one file for each digest.

One process writes at a time and holds ``lock`` for as long as it lives; any number of processes read meanwhile. A
source is on disk before a row refers to it, so an interrupted process leaves at most a file that no row refers to.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shlex
import shutil
import sqlite3
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

import msgspec

from envcraft.corpus.store import database, schema
from envcraft.corpus.store.database import DATABASE, LOCK, UNFINISHED, CorpusBusy, CorpusDamaged
from envcraft.corpus.store.rows import Environment, encode, finding_rows
from envcraft.errors import UsageError
from envcraft.files import atomic_write, refuse_file
from envcraft.judging.settings import Settings
from envcraft.model.verdict import SubjectReport, plain

SOURCES = "sources"
#: The corpus of a plain folder, in that folder.
FOLDER_CORPUS = ".envcraft"
#: The condition that a verdict under the settings ``?`` may become the last verdict on an environment: the settings
#: include all checks, or the environment's present source has no verdict of all checks.
MAY_BE_LAST = """(
    EXISTS (SELECT 1 FROM settings WHERE id = ? AND checks = '') OR NOT EXISTS (
        SELECT 1 FROM verdicts AS whole JOIN settings ON settings.id = whole.settings AND settings.checks = ''
        WHERE whole.id = environments.verdict
        AND whole.source = environments.source AND whole.class = environments.class))"""

#: The condition that a verdict is not settled: EnvCraft could not judge, or the clock decided.
UNSETTLED = "({0}.verdict = 'error' OR coalesce(json_extract({0}.report, '$.out_of_time'), 0))"
#: The condition that a verdict is a pass with a check that left its question open. The first search is quick, and what
#: it finds may also be a key in evidence.
UNDECIDED = """({0}.verdict = 'pass' AND instr({0}.report, '"undecided":true') AND EXISTS (
    SELECT 1 FROM json_each({0}.report, '$.checks') AS one
    WHERE json_extract(one.value, '$.undecided') AND json_extract(one.value, '$.verdict') = 'skip'))"""


class Store:
    """An open corpus; a context manager. Methods that write need ``write=True``.

    Args:
        root: the folder of the corpus, or a plain folder that has one.
        write: whether to become the writer.

    Attributes:
        root: the folder of the corpus.
        db: the connection, used only inside this package.

    Raises:
        UsageError: if there is no corpus at `root`, or it cannot be opened as requested.
        CorpusBusy: if another process writes to it.
        CorpusDamaged: if the database is not what was written; all methods may raise it.
    """

    def __init__(self, root: Path, write: bool = False) -> None:
        self.root = find(root)
        self._unreferenced: set[str] = set()
        self._lock = database.lock(self.root) if write else None
        try:
            with database.translated(self.root):
                self.db = database.connect(self.root, write)
                version = schema.version(self.db, str(self.root))
                if not version:
                    # A database gets its name only when it is complete.
                    raise CorpusDamaged(
                        f"the corpus database {self.root / DATABASE} is empty or does not belong to a corpus",
                        f"`envcraft corpus verify {self.root}` reports the damage",
                    )
                if version < len(schema.MIGRATIONS):
                    if self._lock is None:
                        self._lock = database.lock(self.root)
                        self.db.close()
                        self.db = database.connect(self.root, write=True)
                    schema.migrate(self.db, str(self.root))
            if self._lock is not None:
                # The process that wrote these has ended.
                for stray in (self.root / "tmp").glob("*"):
                    stray.unlink(missing_ok=True)
        except BaseException:
            self.close()
            raise

    @classmethod
    def create(cls, root: Path, folder: bool = False) -> Store:
        """Create a corpus at `root` and open it for writing.

        Args:
            root: a folder that is new or empty.
            folder: whether the corpus follows the files of the folder that `root` lies in.

        Raises:
            UsageError: if `root` is not empty or cannot be written.
        """
        refuse_file(root)
        fresh = not root.exists()
        try:
            root.mkdir(parents=True, exist_ok=True)
            if is_corpus(root):
                raise UsageError(f"{root} is already a corpus")
            # These are the files that an interrupted creation leaves.
            if {path.name for path in root.iterdir()} - {SOURCES, "tmp", LOCK, ".gitignore", *UNFINISHED}:
                raise UsageError(f"{root} is not empty; name a new or empty folder")
            lock = database.lock(root)
            try:
                for part in (SOURCES, "tmp"):
                    (root / part).mkdir(exist_ok=True)
                if folder:
                    # It lies in a folder that may be under version control.
                    (root / ".gitignore").write_text("*\n", "utf-8")
                database.create(root, folder)
            except BaseException:
                if fresh:
                    shutil.rmtree(root, ignore_errors=True)
                raise
            finally:
                os.close(lock)
        except OSError as error:
            raise UsageError(f"cannot create the corpus {root}: {error.strerror or error}") from None
        return cls(root, write=True)

    def __enter__(self) -> Store:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()
        if isinstance(error, sqlite3.DatabaseError) and not isinstance(error, sqlite3.ProgrammingError):
            raise database.translation(self.root, error) from error

    def close(self) -> None:
        """Close the database and release the lock."""
        if "db" in vars(self):
            self.db.close()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextlib.contextmanager
    def transaction(self) -> Iterator[None]:
        """Commit all that the block writes, or nothing of it."""
        self.db.execute("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            self.db.execute("ROLLBACK")
            raise
        self.db.execute("COMMIT")

    @property
    def writes(self) -> bool:
        """Whether the corpus is open for writing."""
        return self._lock is not None

    @property
    def follows_folder(self) -> bool:
        """Whether the corpus follows the files of a folder; otherwise environments are added to it."""
        return self.db.execute("SELECT 1 FROM facts WHERE name = 'folder'").fetchone() is not None

    # Sources

    def place(self, sha256: str) -> Path:
        """The path of a source, whether it exists or not."""
        return self.root / SOURCES / sha256[:2] / sha256[2:4] / f"{sha256}.py"

    def put(self, data: bytes) -> str:
        """Store a source and return its SHA-256 in hex.

        Raises:
            OSError: if the file cannot be written.
        """
        sha256 = hashlib.sha256(data).hexdigest()
        place = self.place(sha256)
        if not place.exists():
            self.keep(place, data)
        return sha256

    def keep(self, place: Path, data: bytes) -> None:
        """Write a file of the corpus atomically and flush it to the disk.

        Raises:
            OSError: if the file cannot be written.
        """
        (self.root / "tmp").mkdir(exist_ok=True)
        place.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(place, temporary=self.root / "tmp", sync=True) as stream:
            stream.write(data)

    def source(self, sha256: str) -> bytes:
        """Read a source.

        Raises:
            CorpusDamaged: if the file is missing or has changed.
        """
        try:
            data = self.place(sha256).read_bytes()
        except OSError as error:
            raise CorpusDamaged(
                f"cannot read the source {self.place(sha256)} ({error.strerror})",
                f"`envcraft corpus verify {self.root} --repair` removes the rows that refer to it",
            ) from None
        if hashlib.sha256(data).hexdigest() != sha256:
            raise CorpusDamaged(
                f"the source {self.place(sha256)} has changed",
                f"`envcraft corpus verify {self.root} --repair` moves it to lost+found",
            )
        return data

    # Environments

    def describe(self, name: str, origin: dict[str, Any]) -> None:
        """Replace the origin of an environment."""
        text = json.dumps(plain(origin), sort_keys=True)
        self.db.execute("UPDATE environments SET origin = ? WHERE name = ?", (text, name))

    def add(self, name: str, data: bytes, env_class: str = "", origin: dict[str, Any] | None = None) -> bool:
        """Add an environment, or replace the source of the one with this name.

        Args:
            name: the name of the environment in the corpus.
            data: its source.
            env_class: the class to judge; empty unless the source has several.
            origin: where the environment comes from; plain data.

        Returns:
            Whether the source or the class differs from before.

        Raises:
            OSError: if the source cannot be written.
        """
        sha256 = self.put(data)
        known = self.db.execute("SELECT source, class FROM environments WHERE name = ?", (name,)).fetchone()
        if known == (sha256, env_class):
            return False
        if known is not None:
            self.release(known[0])
        self.db.execute(
            "INSERT INTO environments (name, source, class, origin, added, changed) "
            "VALUES (?, ?, ?, ?, ?, 1 + coalesce((SELECT max(id) FROM audits), 0)) "
            "ON CONFLICT (name) DO UPDATE SET source = excluded.source, class = excluded.class, "
            "origin = excluded.origin, changed = excluded.changed",
            (name, sha256, env_class, json.dumps(plain(origin or {}), sort_keys=True), now()),
        )
        return True

    def release(self, sha256: str) -> None:
        """Mark a source for :meth:`prune` because an environment no longer refers to it."""
        self._unreferenced.add(sha256)

    def prune(self) -> None:
        """Delete the released sources that no row refers to.

        Call it outside a transaction, which could still be rolled back.
        """
        for sha256 in self._unreferenced:
            if not self.is_referenced(sha256):
                self.place(sha256).unlink(missing_ok=True)
                self.db.execute("DELETE FROM keys WHERE source = ?", (sha256,))
        self._unreferenced.clear()

    def is_referenced(self, sha256: str) -> bool:
        """Whether an environment, a verdict or an attempt refers to a source."""
        query = "SELECT 1 FROM {} WHERE source = ? LIMIT 1"
        tables = ("environments", "verdicts", "attempts")
        return any(self.db.execute(query.format(table), (sha256,)).fetchone() is not None for table in tables)

    def twins(self, data: bytes, env_class: str = "") -> list[str]:
        """The names of the environments with this source and class, sorted."""
        sha256 = hashlib.sha256(data).hexdigest()
        rows = self.db.execute(
            "SELECT name FROM environments WHERE source = ? AND class = ? ORDER BY name", (sha256, env_class)
        )
        return [name for (name,) in rows]

    def remove(self, name: str) -> bool:
        """Remove an environment, and its source and verdicts unless another environment has the same source.

        Returns:
            Whether there was an environment with this name.
        """
        row = self.db.execute("SELECT source FROM environments WHERE name = ?", (name,)).fetchone()
        if row is None:
            return False
        with self.transaction():
            self.db.execute("DELETE FROM environments WHERE name = ?", (name,))
            if self.db.execute("SELECT 1 FROM environments WHERE source = ?", row).fetchone() is None:
                self.db.execute("DELETE FROM verdicts WHERE source = ?", row)
        self.release(row[0])
        self.prune()
        return True

    # Verdicts

    def settings(self, settings: Settings) -> int:
        """The row number of settings, which are inserted if they are new."""
        row = (settings.digest, *msgspec.structs.astuple(settings))
        self.db.execute(
            "INSERT INTO settings "
            "(digest, contract, contract_sha256, rules, seed, budget, driver, image, checks, offered) "
            "VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?) "
            "ON CONFLICT (digest) DO UPDATE SET checks = excluded.checks, offered = excluded.offered "
            # The same checks may be all of them for one installation and some of them for another.
            "WHERE excluded.checks != '?'",
            row,
        )
        number: int = self.db.execute("SELECT id FROM settings WHERE digest = ?", row[:1]).fetchone()[0]
        return number

    def record(self, environment: Environment, settings: int, report: SubjectReport) -> bool:
        """Write a verdict, which counts for every environment with this source and class.

        It becomes the last verdict on these environments, unless it is of some checks only and there is one of all
        checks. A verdict that is not settled never replaces one that is.

        Args:
            environment: the environment that was judged.
            settings: the row number of the settings.
            report: the verdict.

        Returns:
            Whether the verdict was written.
        """
        report = msgspec.structs.replace(report, path=environment.name)
        with self.transaction():
            verdict = self.insert(environment.source, environment.env_class, settings, report)
            kept: str = self.db.execute("SELECT report FROM verdicts WHERE id = ?", (verdict,)).fetchone()[0]
            self.db.execute(
                f"UPDATE environments SET verdict = ? WHERE source = ? AND class = ? AND {MAY_BE_LAST}",
                (verdict, environment.source, environment.env_class, settings),
            )
        return kept == encode(report)

    def insert(self, source: str, env_class: str, settings: int, report: SubjectReport) -> int:
        """Write the rows of a verdict inside a transaction, unless one that is not settled would replace one that is.

        Returns:
            The row number of the verdict under these settings.
        """
        key = (source, env_class, settings)
        cursor = self.db.execute(
            "INSERT INTO verdicts (source, class, settings, verdict, steps, seconds, report) "
            "VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (source, class, settings) DO UPDATE SET "
            "verdict = excluded.verdict, steps = excluded.steps, seconds = excluded.seconds, report = excluded.report "
            f"WHERE NOT {UNSETTLED.format('excluded')} OR {UNSETTLED.format('verdicts')}",
            (*key, report.verdict.value, report.steps, report.seconds, encode(report)),
        )
        verdict: int = self.db.execute(
            "SELECT id FROM verdicts WHERE source = ? AND class = ? AND settings = ?", key
        ).fetchone()[0]
        if cursor.rowcount > 0:
            self.write_findings(verdict, report)
        return verdict

    def write_findings(self, verdict: int, report: SubjectReport) -> None:
        """Replace the finding rows of a verdict by those of its report."""
        self.db.execute("DELETE FROM findings WHERE verdict = ?", (verdict,))
        self.db.executemany(
            "INSERT INTO findings VALUES (?, ?, ?, ?, ?, ?, ?)",
            [(verdict, number, *row) for number, row in enumerate(finding_rows(report), 1)],
        )


def open_store(root: Path, write: bool = False) -> Store:
    """Open a corpus for writing if possible, so that computed keys are stored, else for reading.

    Args:
        root: the folder of the corpus, or a plain folder that has one.
        write: whether reading is not enough.

    Raises:
        UsageError, CorpusBusy, CorpusDamaged: as :class:`Store` does.
    """
    try:
        return Store(root, write=True)
    except (CorpusBusy, UsageError):
        if write:
            raise
        return Store(root)


def now() -> str:
    """The time in UTC, to the second, as ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def is_corpus(root: Path) -> bool:
    """Whether there is a corpus at `root`; false for a folder that may not be read."""
    return os.path.isfile(root / DATABASE)


def find(root: Path) -> Path:
    """The folder of the corpus at `root`, or of the corpus of the plain folder `root`.

    Raises:
        UsageError: if there is none.
    """
    for place in (root, root / FOLDER_CORPUS):
        if is_corpus(place):
            return place
    raise UsageError(f"{root} is not a corpus{_no_corpus(root)}")


def _no_corpus(root: Path) -> str:
    """What there is instead of a corpus, and the next step."""
    name = shlex.quote(str(root))
    if not root.exists():
        folder = "`envcraft audit FOLDER` makes one for a folder"
        return f": it does not exist; `envcraft corpus init {name}` makes one, and {folder}"
    if not root.is_dir():
        return " but a file; `envcraft corpus init NEW` makes one, and `envcraft audit FOLDER` makes one for a folder"
    if any(file.endswith(".py") for _, _, files in os.walk(root) for file in files):
        return (
            f" but a folder of Python files; `envcraft audit {name}` judges them and keeps the verdicts there, "
            f"`envcraft corpus init NEW` and `envcraft corpus add NEW {name}` copy them"
        )
    return " but a folder without Python files; `envcraft corpus init NEW` makes one"
