"""Splits of a corpus that keep duplicates together, so that nothing in one split has a copy in another.

Environments with the same source stay together, too. On request, so do all environments of a family. The same corpus,
fractions and seed give the same splits on any machine, independent of the order in which environments were added.
"""

from __future__ import annotations

import hashlib
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence

from envcraft.corpus.deduplication import LAYERS, groups_of
from envcraft.corpus.store import Store, environments
from envcraft.errors import UsageError
from envcraft.similarity.groups import Groups
from envcraft.similarity.near import THRESHOLD


def corpus_splits(
    store: Store,
    fractions: Sequence[float],
    seed: int = 0,
    layers: Sequence[str] = LAYERS,
    threshold: float = THRESHOLD,
) -> list[list[str]]:
    """Split the environments of a corpus.

    Args:
        store: the corpus.
        fractions: the share of each split; they add up to 1.
        seed: the seed of the order in which environments are assigned.
        layers: the layers that duplicates are found by.
        threshold: the Jaccard index from which sources are near-duplicates.

    Returns:
        The sorted names in each split.

    Raises:
        UsageError: if `fractions` are invalid, or rensa is needed and not installed.
        CorpusDamaged: if a source is missing or has changed.
    """
    # Before the search for duplicates, which takes longer.
    _require(fractions)
    return split(groups_of(store, layers, threshold), fractions, seed)


def family_splits(
    store: Store,
    fractions: Sequence[float] | None = None,
    seed: int = 0,
    layers: Sequence[str] = LAYERS,
    threshold: float = THRESHOLD,
) -> list[list[str]]:
    """Split the environments of a corpus so that no family is in two splits.

    Families that share a duplicate stay together. An environment without a family counts as a family of its own.

    Args:
        store: the corpus.
        fractions: the share of each split; they add up to 1. None makes one split for each family.
        seed: the seed of the order in which families are assigned.
        layers: the layers that duplicates are found by.
        threshold: the Jaccard index from which sources are near-duplicates.

    Returns:
        The sorted names in each split. No split is empty.

    Raises:
        UsageError: if there are fewer families than splits, `fractions` are invalid, or rensa is needed and not
            installed.
        CorpusDamaged: if a source is missing or has changed.
    """
    if fractions is not None:
        _require(fractions)
    groups = _whole(families(store), groups_of(store, layers, threshold))
    shares = [1 / len(groups) for _ in groups] if fractions is None else fractions
    if not groups or len(groups) < len(shares):
        raise UsageError(
            f"{store.root} has {len(groups)} families that share no duplicates, and {max(len(shares), 1)} splits need "
            "one each"
        )
    return split(groups, shares, seed)


def _whole(by_family: Mapping[str, Sequence[str]], duplicates: Sequence[Sequence[str]]) -> list[list[str]]:
    """Join the families that share duplicates."""
    names = sorted(name for members in by_family.values() for name in members)
    numbers = {name: number for number, name in enumerate(names)}
    joined = Groups(len(names))
    for group in [*by_family.values(), *duplicates]:
        for name in group:
            joined.join(numbers[group[0]], numbers[name])
    return [[names[number] for number in group] for group in joined.all()]


def families(store: Store) -> dict[str, list[str]]:
    """The names of the environments of each family. An environment without a family is listed under its own name."""
    found: defaultdict[str, list[str]] = defaultdict(list)
    for row in environments.rows(store):
        found[row.origin.get("family") or row.environment.name].append(row.environment.name)
    return dict(found)


def split(groups: Sequence[Sequence[str]], fractions: Sequence[float], seed: int = 0) -> list[list[str]]:
    """Assign whole groups of names to splits, as close to the fractions as whole groups allow.

    The largest groups come first, each into the split that it fills least. Then the groups of one name fill the splits
    up in an order that the seed shuffles, so that one more of them moves at most one name over each border. No split is
    empty if there are enough groups.

    Args:
        groups: disjoint groups of names.
        fractions: the share of each split; they add up to 1.
        seed: the seed of the order.

    Returns:
        The sorted names in each split.

    Raises:
        UsageError: if `fractions` are invalid.
    """
    _require(fractions)
    total = sum(map(len, groups))
    splits: list[list[str]] = [[] for _ in fractions]
    ordered = sorted(groups, key=lambda group: (-len(group), _shuffled(min(group), seed)))
    single: list[str] = []
    for place, group in enumerate(ordered):
        empty = [number for number, names in enumerate(splits) if not names]
        scarce = len(ordered) - place <= len(empty)
        if len(group) > 1 or scarce:
            filled = [(len(names) + len(group)) / part for names, part in zip(splits, fractions, strict=True)]
            splits[min(empty if scarce else range(len(splits)), key=filled.__getitem__)] += group
        else:
            single += group
    missing = [max(part * total - len(names), 0) for names, part in zip(splits, fractions, strict=True)]
    bounds = [round(sum(missing[:place]) / (sum(missing) or 1) * len(single)) for place in range(len(missing) + 1)]
    for place, names in enumerate(splits):
        names += single[bounds[place] : bounds[place + 1]]
    return [sorted(names) for names in splits]


def _require(fractions: Sequence[float]) -> None:
    """Raise UsageError if fractions are no shares of a whole."""
    if not fractions or any(not 0 < fraction <= 1 for fraction in fractions):
        raise UsageError(f"each of the fractions {_words(fractions)} must be above 0 and at most 1")
    if not math.isclose(sum(fractions), 1, abs_tol=1e-6):
        raise UsageError(f"the fractions {_words(fractions)} add up to {sum(fractions):g}, not to 1")


def _shuffled(name: str, seed: int) -> tuple[bytes, str]:
    return hashlib.blake2b(f"{seed} {name}".encode("utf-8", "surrogatepass"), digest_size=8).digest(), name


def _words(fractions: Sequence[float]) -> str:
    return ",".join(f"{fraction:g}" for fraction in fractions)
