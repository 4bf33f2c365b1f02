"""One corpus into another: environments, their sources, the verdicts on them, and how they came about. Merged twice, it
changes nothing.
"""

from __future__ import annotations

import json

import msgspec

from envcraft.corpus.history import TABLES
from envcraft.corpus.settings import Settings
from envcraft.corpus.store import Store, decode, settled
from envcraft.errors import UsageError


class Merged(msgspec.Struct):
    """What came over. `renamed` has the old and the new names of those whose name stands for another source here."""

    added: int = 0
    verdicts: int = 0
    concepts: int = 0
    renamed: list[tuple[str, str]] = []


def merge(store: Store, other: Store) -> Merged:
    """Take over what `store` lacks. Where both have a verdict, its own stays, unless the other one could be judged.

    The other's list of audits stays behind: it says since when `store` has changed, and an audit that never was in here
    would make ``--changed`` pass over what only this one holds.

    Raises UsageError where both are one; OSError, CorpusDamaged.
    """
    if store.root.resolve() == other.root.resolve():
        raise UsageError(f"{other.root} is this corpus itself; name another one")
    merged = Merged()
    for name, source, env_class, origin in other.db.execute(
        "SELECT name, source, class, origin FROM environments ORDER BY name"
    ):
        with store.transaction():
            _environment(store, other, merged, name, source, env_class, json.loads(origin))
    numbers = {
        number: store.settings(Settings(*row))
        for number, *row in other.db.execute(
            "SELECT id, contract, contract_sha256, rules, seed, budget, driver, image, checks, offered FROM settings"
        )
    }
    for source, env_class, settings, verdict, report in other.db.execute(
        "SELECT source, class, settings, verdict, report FROM verdicts ORDER BY id"
    ):
        known = store.db.execute(
            "SELECT verdict FROM verdicts WHERE source = ? AND class = ? AND settings = ?",
            (source, env_class, numbers[settings]),
        ).fetchone()
        if known is None or (settled(verdict) and not settled(known[0])):
            with store.transaction():
                store.insert(source, env_class, numbers[settings], decode(report))
            merged.verdicts += 1
    with store.transaction():
        _last_verdicts(store, other, numbers)
    for (concept,) in other.db.execute("SELECT id FROM concepts ORDER BY id").fetchall():
        with store.transaction():
            merged.concepts += _history(store, other, numbers, concept)
    return merged


def _history(store: Store, other: Store, numbers: dict[int, int], concept: str) -> bool:
    """Take over how far a concept has come, where it has come further there; give whether it has."""
    reached = "SELECT 1 + count(stage) FROM concepts LEFT JOIN outcomes ON concept = id WHERE id = ? GROUP BY id"
    theirs, mine = (one.db.execute(reached, (concept,)).fetchone() for one in (other, store))
    if mine is not None and mine >= theirs:
        return False
    store.db.execute("DELETE FROM concepts WHERE id = ?", (concept,))
    for table, key in (("concepts", "id"), *((table, "concept") for table in TABLES)):
        cursor = other.db.execute(f"SELECT * FROM {table} WHERE {key} = ?", (concept,))
        columns = [column[0] for column in cursor.description]
        for row in cursor:
            told = dict(zip(columns, row, strict=True))
            if table == "attempts":
                store.put(other.source(told["source"]))
                told["verdict"] = _verdict_here(store, other, numbers, told["verdict"])
            store.db.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(told))})", tuple(told.values()))
    return True


def _verdict_here(store: Store, other: Store, numbers: dict[int, int], verdict: int | None) -> int | None:
    """The number here of a verdict there."""
    row = other.db.execute("SELECT source, class, settings FROM verdicts WHERE id = ?", (verdict,)).fetchone()
    if row is None:
        return None
    query = "SELECT id FROM verdicts WHERE source = ? AND class = ? AND settings = ?"
    found: tuple[int] = store.db.execute(query, (*row[:2], numbers[row[2]])).fetchone()
    return found[0]


def _last_verdicts(store: Store, other: Store, numbers: dict[int, int]) -> None:
    """What has no last verdict here gets the other one's; `numbers` are the settings of here by those of there."""
    for source, env_class, *judged, settings in other.db.execute(
        "SELECT e.source, e.class, v.source, v.class, v.settings FROM environments AS e JOIN verdicts AS v "
        # One on what an environment is now before one on what another of the same source was once.
        "ON v.id = e.verdict ORDER BY v.source = e.source AND v.class = e.class DESC, e.name"
    ):
        store.db.execute(
            "UPDATE environments SET verdict = (SELECT id FROM verdicts AS v WHERE v.source = ? AND v.class = ? "
            "AND v.settings = ?) WHERE source = ? AND class = ? AND verdict IS NULL",
            (*judged, numbers[settings], source, env_class),
        )


def _environment(
    store: Store, other: Store, merged: Merged, name: str, source: str, env_class: str, origin: dict[str, object]
) -> None:
    data = other.source(source)
    for free in (name, f"{name}@{source[:8]}", f"{name}@{source}"):
        known = store.db.execute("SELECT source, class FROM environments WHERE name = ?", (free,)).fetchone()
        if known == (source, env_class):
            return
        if known is None:
            store.add(free, data, env_class, origin)
            merged.added += 1
            if free != name:
                merged.renamed.append((name, free))
            return
    raise UsageError(f"{other.root}: the name {name} stands for two classes of one source; rename one of them")
