"""Clusters of concepts that belong to one split, so that no split has a near-duplicate of a row in another.

All attempts at a concept share its brief and stay together. Concepts are connected by near-duplicates among all their
sources, broken ones included, and through environments of the corpus that come from elsewhere
(:mod:`envcraft.corpus.deduplication`); and by briefs that are equal except for case and spacing.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from envcraft.corpus.deduplication import clusters
from envcraft.corpus.export.shards import SPLITS
from envcraft.corpus.splits import split
from envcraft.corpus.store import Environment, Store, environments, generation
from envcraft.similarity.groups import Groups


def concept_clusters(store: Store) -> list[list[str]]:
    """Return the clusters: each concept with attempts is in exactly one.

    Raises:
        UsageError: If rensa is not installed.
        CorpusDamaged: If a source is missing or damaged.
    """
    attempts = generation.attempt_sources(store)
    members = [Environment(f"attempt {concept} {number}", source, name) for concept, number, source, name in attempts]
    members += [one._replace(name=f"environment {one.name}") for one in environments.every(store)]
    numbers = {member.name: number for number, member in enumerate(members)}
    groups = Groups(len(members))
    for cluster in clusters(store, members=members).clusters:
        for name in cluster.members:
            groups.join(numbers[cluster.members[0]], numbers[name])
    briefs = {concept: _digest(text) for concept, text in generation.briefs(store).items()}
    first: dict[tuple[str, object], int] = {}
    for number, member in enumerate(members):
        groups.join(first.setdefault(("source", member.source), number), number)
    for number, (concept, *_) in enumerate(attempts):
        groups.join(first.setdefault(("concept", concept), number), number)
        groups.join(first.setdefault(("brief", briefs.get(concept, concept)), number), number)
    concepts = [sorted({attempts[number][0] for number in group if number < len(attempts)}) for group in groups.all()]
    return [cluster for cluster in concepts if cluster]


def assign_splits(
    all_clusters: list[list[str]], validated: Mapping[str, bool]
) -> tuple[dict[str, int], dict[str, str]]:
    """Assign a cluster number and a split to each concept of `validated`.

    Clusters with a validated concept and the other clusters are split separately, so that every split has both.

    Args:
        all_clusters: Clusters of concepts.
        validated: For each concept to assign, whether it was validated.

    Returns:
        Cluster number by concept, and split by concept.
    """
    kept = sorted(sorted(set(validated).intersection(cluster)) for cluster in all_clusters)
    kept = [cluster for cluster in kept if cluster]
    numbers = {concept: number for number, cluster in enumerate(kept) for concept in cluster}
    splits: dict[str, str] = {}
    for value in (True, False):
        part = [cluster for cluster in kept if any(validated[concept] for concept in cluster) is value]
        for name, concepts in zip(SPLITS, split(part, list(SPLITS.values())), strict=True):
            splits |= dict.fromkeys(concepts, name)
    return numbers, splits


def _digest(text: str) -> str:
    return hashlib.sha256(" ".join(text.lower().split()).encode()).hexdigest()
