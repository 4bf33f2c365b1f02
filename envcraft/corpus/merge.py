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
                number = store.insert(source, env_class, numbers[settings], decode(report))
                store.db.execute(
                    "UPDATE environments SET verdict = ? WHERE source = ? AND class = ? AND verdict IS NULL",
                    (number, source, env_class),
                )
            merged.verdicts += 1
    return merged


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
