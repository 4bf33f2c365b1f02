"""Splits of a corpus that keep duplicates together, so that nothing in one split has a copy in another.

Environments with the same source stay together, too. The same corpus, fractions and seed give the same splits on any
machine, independent of the order in which environments were added.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

from envcraft.corpus.deduplication import LAYERS, groups_of
from envcraft.corpus.store import Store
from envcraft.errors import UsageError
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
    return split(groups_of(store, layers, threshold), fractions, seed)


def split(groups: Sequence[Sequence[str]], fractions: Sequence[float], seed: int = 0) -> list[list[str]]:
    """Assign whole groups of names to splits, as close to the fractions as whole groups allow.

    The largest groups come first, each into the split that it fills least. Then the groups of one name fill the splits
    up in an order that the seed shuffles, so that one more of them moves at most one name over each border.

    Args:
        groups: disjoint groups of names.
        fractions: the share of each split; they add up to 1.
        seed: the seed of the order.

    Returns:
        The sorted names in each split.

    Raises:
        UsageError: if `fractions` are invalid.
    """
    if not fractions or any(not 0 < fraction <= 1 for fraction in fractions):
        raise UsageError(f"each of the fractions {_words(fractions)} must be above 0 and at most 1")
    if not math.isclose(sum(fractions), 1, abs_tol=1e-6):
        raise UsageError(f"the fractions {_words(fractions)} add up to {sum(fractions):g}, not to 1")
    total = sum(map(len, groups))
    splits: list[list[str]] = [[] for _ in fractions]
    ordered = sorted(groups, key=lambda group: (-len(group), _shuffled(min(group), seed)))
    for group in ordered:
        if len(group) > 1:
            filled = [(len(names) + len(group)) / part for names, part in zip(splits, fractions, strict=True)]
            splits[filled.index(min(filled))] += group
    single = [name for group in ordered if len(group) == 1 for name in group]
    missing = [max(part * total - len(names), 0) for names, part in zip(splits, fractions, strict=True)]
    bounds = [round(sum(missing[:place]) / (sum(missing) or 1) * len(single)) for place in range(len(missing) + 1)]
    for place, names in enumerate(splits):
        names += single[bounds[place] : bounds[place + 1]]
    return [sorted(names) for names in splits]


def _shuffled(name: str, seed: int) -> tuple[bytes, str]:
    return hashlib.blake2b(f"{seed} {name}".encode("utf-8", "surrogatepass"), digest_size=8).digest(), name


def _words(fractions: Sequence[float]) -> str:
    return ",".join(f"{fraction:g}" for fraction in fractions)
