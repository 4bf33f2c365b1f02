"""Splits of a corpus, for training and testing say, that never cut a cluster: what is in one split has no copy in
another.

Environments that come from one source stay together, too. The same corpus, fractions and seed give the same splits on
any machine, whatever the order in which environments were added.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

from envcraft.corpus.likeness import LAYERS, groups_of
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
    """The names of environments in each split, sorted: of `store`, whose clusters are those of `layers`.

    Raises UsageError for fractions that are none, or without rensa; CorpusDamaged.
    """
    return split(groups_of(store, layers, threshold), fractions, seed)


def split(groups: Sequence[Sequence[str]], fractions: Sequence[float], seed: int = 0) -> list[list[str]]:
    """Assign whole groups of names to one split for each fraction, as close to the fractions as whole groups allow.

    The largest groups come first, and each goes where it fills the least; then those of one name fill up what is
    missing, in an order that the seed shuffles. So one more of these moves no more than one name over each border.
    Raises UsageError.
    """
    if not fractions or any(not 0 < fraction <= 1 for fraction in fractions):
        raise UsageError(f"the fractions {_words(fractions)} are not all above 0 and at most 1")
    if not math.isclose(sum(fractions), 1, abs_tol=1e-6):
        raise UsageError(f"the fractions {_words(fractions)} add up to {sum(fractions):g}, not to 1")
    total = sum(map(len, groups))
    found: list[list[str]] = [[] for _ in fractions]
    ordered = sorted(groups, key=lambda group: (-len(group), _shuffled(min(group), seed)))
    for group in ordered:
        if len(group) > 1:
            filled = [(len(names) + len(group)) / part for names, part in zip(found, fractions, strict=True)]
            found[filled.index(min(filled))] += group
    single = [name for group in ordered if len(group) == 1 for name in group]
    missing = [max(part * total - len(names), 0) for names, part in zip(found, fractions, strict=True)]
    bounds = [round(sum(missing[:place]) / (sum(missing) or 1) * len(single)) for place in range(len(missing) + 1)]
    for place, names in enumerate(found):
        names += single[bounds[place] : bounds[place + 1]]
    return [sorted(names) for names in found]


def _shuffled(name: str, seed: int) -> tuple[bytes, str]:
    return hashlib.blake2b(f"{seed} {name}".encode("utf-8", "surrogatepass"), digest_size=8).digest(), name


def _words(fractions: Sequence[float]) -> str:
    return ",".join(f"{fraction:g}" for fraction in fractions)
