"""Merging one corpus into another: environments, sources, verdicts and generation history.

Merging the same corpus twice changes nothing.
"""

from __future__ import annotations

import msgspec

from envcraft.corpus.store import Environment, Store, decode, environments, generation, verdicts
from envcraft.corpus.store.environments import EnvironmentRow
from envcraft.errors import UsageError
from envcraft.model.verdict import Verdict


class Merged(msgspec.Struct):
    """What was added. `renamed` has the old and new names of environments whose names were taken."""

    added: int = 0
    verdicts: int = 0
    concepts: int = 0
    renamed: list[tuple[str, str]] = []


def merge(store: Store, other: Store) -> Merged:
    """Add what `store` lacks. If both have a verdict, that of `store` stays unless it is an error.

    The audits of `other` stay behind: ``--changed`` selects what changed since the last audit of `store`, and an audit
    that never ran on `store` would hide what only `store` has.

    Args:
        store: the corpus to write.
        other: the corpus to read.

    Raises:
        UsageError: if both are the same corpus.
        OSError: if `store` cannot be written.
        CorpusDamaged: if a corpus is damaged.
    """
    if store.root.resolve() == other.root.resolve():
        raise UsageError(f"{other.root} is the same corpus; name another one")
    merged = Merged()
    for row in environments.rows(other):
        with store.transaction():
            _add_environment(store, other, merged, row)
    settings = {number: store.settings(one) for number, one in verdicts.all_settings(other).items()}
    numbers: dict[int, int] = {}
    for verdict in verdicts.rows(other):
        key = (verdict.source, verdict.env_class, settings[verdict.settings])
        known = verdicts.under(store, *key)
        if known is None or (verdict.verdict != Verdict.ERROR and known[1] is Verdict.ERROR):
            with store.transaction():
                numbers[verdict.number] = store.insert(*key, decode(verdict.report))
            merged.verdicts += 1
        else:
            numbers[verdict.number] = known[0]
    with store.transaction():
        for source, env_class, judged, judged_class, theirs in verdicts.last_rows(other):
            verdicts.set_missing_last(store, source, env_class, (judged, judged_class), settings[theirs])
    for concept in generation.concepts(other):
        with store.transaction():
            merged.concepts += _add_concept(store, other, concept, numbers)
    return merged


def _add_concept(store: Store, other: Store, concept: str, numbers: dict[int, int]) -> bool:
    """Copy a concept that has more outcomes in `other`, and return whether it has.

    Args:
        store: the corpus to write.
        other: the corpus to read.
        concept: the id of the concept.
        numbers: the row numbers of verdicts in `store` by those in `other`.
    """
    mine, theirs = generation.progress(store, concept), generation.progress(other, concept)
    if mine is not None and theirs is not None and mine >= theirs:
        return False
    for attempt in generation.attempts(other, concept):
        store.put(other.source(attempt.source))
    generation.copy_concept(store, other, concept, numbers)
    return True


def _add_environment(store: Store, other: Store, merged: Merged, row: EnvironmentRow) -> None:
    name, source, env_class = row.environment
    data = other.source(source)
    for free in (name, f"{name}@{source[:8]}", f"{name}@{source}"):
        known = environments.get(store, free)
        if known is None:
            store.add(free, data, env_class, row.origin)
            merged.added += 1
            if free != name:
                merged.renamed.append((name, free))
            return
        if known.environment == Environment(free, source, env_class):
            return
    raise UsageError(f"{other.root}: the name {name} stands for two classes of one source; rename one of them")
