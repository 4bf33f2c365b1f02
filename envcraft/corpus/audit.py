"""One audit: which environments are meant, which of them have a verdict already, and the judging of the others.

Everything that grows with the corpus stays in the database or is read one by one; in memory are the names of what is to
be judged.
"""

from __future__ import annotations

import contextlib
import os
import random
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Any

import msgspec

from envcraft.corpus.store import LEADS, CorpusDamaged, Environment, Store, decode, now
from envcraft.errors import EnvCraftError, TargetLost
from envcraft.events import Event, SubjectFinished
from envcraft.target import LazyTargets, Target
from envcraft.verdict import SubjectReport, Verdict

#: What an audit is about: one row for each environment, in the temporary database of its connection.
_CHOSEN = "CREATE TEMP TABLE chosen (name TEXT PRIMARY KEY) WITHOUT ROWID"
_VERDICTS = (
    "chosen JOIN environments USING (name) LEFT JOIN verdicts ON verdicts.source = environments.source "
    "AND verdicts.class = environments.class AND verdicts.settings = ?"
)


class Choice(msgspec.Struct, frozen=True):
    """Which environments an audit is about: all of them, unless told otherwise.

    Attributes:
        only_failed: those whose last verdict was no pass, whatever their source has become since.
        changed: those that are new, or whose source or class is, since the last audit that came to its end and left
            nothing of that out, and those without a verdict under the same settings.
        sample: so many of what is left, picked by `seed`.
    """

    only_failed: bool = False
    changed: bool = False
    sample: int | None = None
    seed: int = 0


def stored(store: Store, environments: Sequence[Environment], folder: str = "") -> LazyTargets[Environment]:
    """Environments as targets whose names lead from `folder`. Asking for one raises TargetLost where its source is gone
    or has changed.
    """

    def read(environment: Environment) -> Target:
        name, source, env_class = environment
        path = os.path.join(folder, name)
        try:
            return Target(path, store.source(source), env_class or None)
        except CorpusDamaged as error:
            raise TargetLost(path, env_class or None, source, str(error)) from None

    return LazyTargets(environments, read)


class Audit:
    """An audit of `store` under settings. `folder` goes before names, so that they lead to the files.

    Attributes:
        number: of the audit in the store.
        selected: how many environments it is about.
        pending: those that have to be judged: one for each source, with verdicts of which all that have it are served.
        kept: of those that could not be judged again, the reports; the verdicts of before stay.
    """

    def __init__(self, store: Store, settings: int, choice: Choice, folder: str = "", resume: bool = True) -> None:
        """Choose, and write down that the audit has begun; without `resume`, nothing counts as judged."""
        self.store, self.settings, self.folder = store, settings, folder
        self.kept: list[SubjectReport] = []
        self.selected, complete = _choose(store, choice, settings)
        found = store.db.execute(
            # The first name of each source, so that it does not matter where an earlier run ended.
            f"SELECT min(name), environments.source, environments.class FROM {_VERDICTS} "
            "WHERE verdicts.id IS NULL OR verdicts.verdict = 'error' OR ? "
            "GROUP BY environments.source, environments.class ORDER BY 1",
            (settings, not resume),
        )
        self.pending = [Environment(*row) for row in found]
        with store.transaction():
            # What is known already is the last verdict of these, too.
            store.db.execute(
                "UPDATE environments SET verdict = v.id FROM verdicts AS v WHERE v.source = environments.source "
                "AND v.class = environments.class AND v.settings = ? "
                f"AND environments.name IN (SELECT name FROM chosen) AND {LEADS}",
                (settings, settings),
            )
            cursor = store.db.execute(
                "INSERT INTO audits (settings, started, selected, known, complete) VALUES (?, ?, ?, ?, ?)",
                (settings, now(), self.selected, self.known, complete),
            )
        assert cursor.lastrowid is not None
        self.number = cursor.lastrowid

    @property
    def known(self) -> int:
        """How many environments have a verdict that stands, or share one that is to come."""
        return self.selected - len(self.pending)

    @property
    def targets(self) -> LazyTargets[Environment]:
        """What is to be judged."""
        return stored(self.store, self.pending, self.folder)

    def run(self, judging: Generator[tuple[int, Event], None, None], tell: Callable[[Event], None]) -> None:
        """Take in the judging of what is pending, whose events come with its numbers, from 1: each verdict is written
        down before `tell` hears of it. Raises what ends the judging.
        """
        with contextlib.closing(judging) as events:
            for number, event in events:
                if isinstance(event, SubjectFinished) and not self.store.record(
                    self.pending[number - 1], self.settings, event.report
                ):
                    self.kept.append(event.report)
                tell(event)

    def end(self) -> None:
        """Write down that the audit has come to its end."""
        self.store.db.execute("UPDATE audits SET ended = ? WHERE id = ?", (now(), self.number))

    # What came out, each environment in the order of its name

    def reports(self) -> Iterator[SubjectReport]:
        """Every verdict, with the environment's own path."""
        for name, report in self._rows("name, report", "report IS NOT NULL ORDER BY name"):
            yield msgspec.structs.replace(decode(report), path=self.path(name))

    def report(self, name: str) -> SubjectReport | None:
        """The verdict on one environment."""
        for (report,) in self._rows("report", "name = ? AND report IS NOT NULL", name):
            return decode(report)
        return None

    def findings(self) -> Iterator[tuple[str, str, str, str]]:
        """The path, check, code and message of each finding, those of one environment in their order."""
        rows = self.store.db.execute(
            f"SELECT name, rule_check, code, message FROM {_VERDICTS} JOIN findings ON findings.verdict = verdicts.id "
            "ORDER BY name, number",
            (self.settings,),
        )
        for name, check, code, message in rows:
            yield self.path(name), check, code, message

    def verdicts(self) -> dict[str, int]:
        """How many environments have which verdict."""
        found = dict(self._rows("verdicts.verdict, count(*)", "verdicts.id IS NOT NULL GROUP BY verdicts.verdict"))
        return {verdict.value: found[verdict] for verdict in Verdict if verdict in found}

    def codes(self) -> dict[str, int]:
        """In how many environments each code was found, the most frequent first."""
        rows = self.store.db.execute(
            f"SELECT code, count(DISTINCT name) AS times FROM {_VERDICTS} JOIN findings "
            "ON findings.verdict = verdicts.id GROUP BY code ORDER BY times DESC, code",
            (self.settings,),
        )
        return dict(rows)

    def totals(self) -> tuple[int, float]:
        """Environment steps, and seconds of judging, of all verdicts whenever they were given."""
        found: tuple[int, float] = next(self._rows("coalesce(sum(steps), 0), coalesce(sum(seconds), 0.0)", "1"))
        return found

    def path(self, name: str) -> str:
        """What an environment is called in reports."""
        return os.path.join(self.folder, name)

    def name(self, path: str) -> str | None:
        """The environment that is meant by a path in a report; None where this audit is not about it."""
        name = os.path.relpath(path, self.folder) if self.folder else path
        row = self.store.db.execute("SELECT name FROM chosen WHERE name = ?", (name,)).fetchone()
        return row[0] if row else None

    def _rows(self, columns: str, condition: str, *values: Any) -> Iterator[Any]:
        yield from self.store.db.execute(
            f"SELECT {columns} FROM {_VERDICTS} WHERE {condition}", (self.settings, *values)
        )


def follow(store: Store, files: Iterable[tuple[str, Target]]) -> None:
    """Make the store's environments those of a folder: names with targets. Verdicts on what is gone are kept.

    Raises EnvCraftError where a source cannot be written.
    """
    db = store.db
    db.execute("CREATE TEMP TABLE IF NOT EXISTS present (name TEXT PRIMARY KEY) WITHOUT ROWID")
    with store.transaction():
        db.execute("DELETE FROM present")
        for name, target in files:
            try:
                store.add(name, target.source, target.env_class or "")
            except OSError as error:
                raise EnvCraftError(f"{target.path} cannot be kept in {store.root}: {error.strerror}") from None
            db.execute("INSERT INTO present VALUES (?)", (name,))
        gone = "name NOT IN (SELECT name FROM present)"
        for (sha256,) in db.execute(f"SELECT source FROM environments WHERE {gone}"):
            store.leave(sha256)
        db.execute(f"DELETE FROM environments WHERE {gone}")
    store.prune()


def _choose(store: Store, choice: Choice, settings: int) -> tuple[int, bool]:
    """Fill the table of what an audit is about; give how many, and whether all that had changed is among them."""
    db = store.db
    conditions, complete = ["1"], not choice.only_failed
    if choice.only_failed:
        conditions.append("verdict IN (SELECT id FROM verdicts WHERE verdict IN ('fail', 'error'))")
    if choice.changed:
        conditions.append(
            "(changed > (SELECT coalesce(max(id), 0) FROM audits WHERE ended IS NOT NULL AND complete) "
            "OR NOT EXISTS (SELECT 1 FROM verdicts AS v WHERE v.source = environments.source "
            f"AND v.class = environments.class AND v.settings = {settings:d} AND v.verdict != 'error'))"
        )
    names = f"SELECT name FROM environments WHERE {' AND '.join(conditions)}"
    db.execute("DROP TABLE IF EXISTS chosen")
    db.execute(_CHOSEN)
    if choice.sample is None:
        db.execute(f"INSERT INTO chosen {names}")
    else:
        found = [name for (name,) in db.execute(f"{names} ORDER BY name")]
        complete = complete and len(found) <= choice.sample
        picked = random.Random(choice.seed).sample(found, min(choice.sample, len(found)))
        db.executemany("INSERT INTO chosen VALUES (?)", [(name,) for name in picked])
    count: int = db.execute("SELECT count(*) FROM chosen").fetchone()[0]
    return count, complete
