"""One corpus into another: environments, their sources, and the verdicts on them. Merged twice, it changes nothing."""

from __future__ import annotations

import json

import msgspec

from envcraft.corpus.settings import Settings
from envcraft.corpus.store import Store, decode, settled
from envcraft.errors import UsageError


class Merged(msgspec.Struct):
    """What came over. `renamed` has the old and the new names of those whose name stands for another source here."""

    added: int = 0
    verdicts: int = 0
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
            "SELECT id, contract, contract_sha256, rules, seed, budget, driver, image, checks FROM settings"
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
    return merged


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
