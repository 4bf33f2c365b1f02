"""Which concepts belong together, so that nothing in one split has a copy in another.

All attempts at a concept share its brief, and stay together. Concepts are connected by near-duplicates among all their
sources, broken ones too, and by environments of the corpus that came from elsewhere
(:mod:`envcraft.corpus.likeness`); and by a brief that is the same but for case and spacing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from envcraft.corpus.export.shards import SPLITS
from envcraft.corpus.likeness import Member, clusters
from envcraft.corpus.splits import split
from envcraft.corpus.store import Store
from envcraft.similarity.groups import Groups


def groups(store: Store) -> list[list[str]]:
    """Every concept that has attempts in exactly one group. Raises UsageError without rensa, CorpusDamaged."""
    query = "SELECT concept, number, source, class FROM attempts ORDER BY concept, number"
    attempts = store.db.execute(query).fetchall()
    members = [Member(f"attempt {concept} {number}", source, picked) for concept, number, source, picked in attempts]
    environments = store.db.execute("SELECT name, source, class FROM environments ORDER BY name")
    members += [Member(f"environment {name}", source, picked) for name, source, picked in environments]
    numbers = {member.name: number for number, member in enumerate(members)}
    together = Groups(len(members))
    for cluster in clusters(store, members=members).clusters:
        for name in cluster.members:
            together.join(numbers[cluster.members[0]], numbers[name])
    briefs = {concept: _digest(text) for concept, text in store.db.execute("SELECT concept, text FROM briefs")}
    first: dict[tuple[str, object], int] = {}
    for number, member in enumerate(members):
        together.join(first.setdefault(("source", member.source), number), number)
    for number, (concept, *_) in enumerate(attempts):
        together.join(first.setdefault(("concept", concept), number), number)
        together.join(first.setdefault(("brief", briefs.get(concept, concept)), number), number)
    found = [sorted({attempts[number][0] for number in group if number < len(attempts)}) for group in together.all()]
    return [group for group in found if group]


def divided(found: list[list[str]], wanted: Mapping[str, bool]) -> tuple[dict[str, int], dict[str, str]]:
    """The number of the group, and the split, of each concept in `wanted`, which says whether it was validated: groups
    with a concept that was, and others, are split each by themselves, so that both are everywhere.
    """
    kept = sorted(sorted(set(wanted).intersection(group)) for group in found)
    kept = [group for group in kept if group]
    numbers = {concept: number for number, group in enumerate(kept) for concept in group}
    splits: dict[str, str] = {}
    for validated in (True, False):
        part = [group for group in kept if any(wanted[concept] for concept in group) is validated]
        for name, concepts in zip(SPLITS, split(part, list(SPLITS.values())), strict=True):
            splits |= dict.fromkeys(concepts, name)
    return numbers, splits


def _digest(text: str) -> str:
    return hashlib.sha256(" ".join(text.lower().split()).encode()).hexdigest()
