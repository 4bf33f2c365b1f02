"""The layer ``near``: mostly the same text.

A source is the set of its 5-grams of tokens, called shingles. The similarity of two sources is the Jaccard index of
their sets. From 0.7 on they are near-duplicates, the threshold of the BigCode project for its corpus of code [1]_.

Generated environments share a scaffold: imports, spaces, the skeleton of ``reset`` and ``step``. The layer first
removes shingles that occur in more than a tenth of the corpus and in at least five sources. It counts families instead
of files: sources with a similarity of 0.85, scaffold included, count once. Otherwise a game that makes up a fifth of
the corpus would count as scaffold. A source with fewer than :data:`FEWEST` shingles of its own has no key.

MinHash [2]_ (of `rensa`) with locality-sensitive hashing proposes pairs; its bands find 99 of 100 pairs at the
threshold. Each proposed pair is measured on the sets themselves, so no reported pair is below the threshold.

.. [1] Kocetkov et al., The Stack: 3 TB of permissively licensed source code, 2022.
.. [2] Broder, On the resemblance and containment of documents, 1997.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft.similarity.groups import Groups
from envcraft.similarity.reading import END, IN, OUT, read_tokens

#: Version of the keys. A new version invalidates stored keys.
VERSION = 1
THRESHOLD = 0.7
#: Tokens of a shingle.
LENGTH = 5
#: Shingles of its own that a source needs for a key.
FEWEST = 20
#: Shingles are scaffold in more than this share of the families, and in at least this number.
SHARE, LEAST = 0.1, 5
_FAMILY = 0.85
_PERMUTATIONS, _SEED = 128, 7
_RECALL = 0.99

Shingles: TypeAlias = NDArray[np.uint32]


def key(source: bytes) -> bytes | None:
    """The digests of a source's shingles, sorted, four bytes each; None if it cannot be tokenised."""
    tokens = read_tokens(source)
    if tokens is None:
        return None
    words = [word for word in tokens if word not in (END, IN, OUT)]
    if len(words) < LENGTH:
        return b""
    known: dict[str, int] = {}
    for word in words:
        if word not in known:
            known[word] = zlib.crc32(word.encode("utf-8", "surrogatepass"))
    numbers = np.array([known[word] for word in words], np.uint64)
    mixed = np.zeros(len(words) - LENGTH + 1, np.uint64)
    for place in range(LENGTH):
        mixed = _mix(mixed + numbers[place : place + len(mixed)])
    return np.unique((mixed >> np.uint64(32)).astype("<u4")).tobytes()


def shingles(stored: bytes) -> Shingles:
    """The set of digests in a key."""
    return np.frombuffer(stored, "<u4")


def own(sets: Sequence[Shingles]) -> list[Shingles | None]:
    """Each set without the corpus's scaffold; None if too few shingles are left. Raises UsageError without rensa."""
    families = Groups(len(sets))
    for one, two in pairs(sets, _FAMILY, families):
        families.join(one, two)
    # The union of the members' sets.
    merged = [np.unique(np.concatenate([sets[member] for member in family])) for family in families.all()]
    limit = max(SHARE * len(merged), LEAST - 1)
    if merged:
        values, counts = np.unique(np.concatenate(merged), return_counts=True)
        scaffold = values[counts > limit]
    else:
        scaffold = np.zeros(0, np.uint32)
    left = [found[~np.isin(found, scaffold, assume_unique=True)] for found in sets]
    return [found if len(found) >= FEWEST else None for found in left]


def pairs(sets: Sequence[Shingles], threshold: float, joined: Groups) -> Iterator[tuple[int, int]]:
    """Yield pairs with at least the similarity `threshold`, except those that are in one group of `joined` by then."""
    rows = signatures(sets)
    width = _rows(threshold)
    refused: set[tuple[int, int]] = set()
    for start in range(0, _PERMUTATIONS, width):
        buckets: dict[bytes, list[int]] = {}
        for number, row in enumerate(rows):
            if len(sets[number]):
                buckets.setdefault(row[start : start + width].tobytes(), []).append(number)
        for bucket in buckets.values():
            if joined.one(bucket):
                continue
            for place, two in enumerate(bucket):
                for one in bucket[:place]:
                    if joined.same(one, two) or (one, two) in refused:
                        continue
                    if jaccard(sets[one], sets[two]) >= threshold:
                        yield one, two
                    else:
                        refused.add((one, two))


def jaccard(one: Shingles, two: Shingles) -> float:
    """The Jaccard index of two sets; 0 for two empty sets."""
    both = len(np.intersect1d(one, two, assume_unique=True))
    either = len(one) + len(two) - both
    return both / either if either else 0.0


def signatures(sets: Sequence[Shingles]) -> NDArray[np.uint32]:
    """MinHash signatures, shape ``(len(sets), 128)``. Raises UsageError without rensa."""
    try:
        from rensa import RMinHash
    except ImportError:
        raise UsageError(
            "the layer near needs rensa: pip install 'envcraft-rl[corpus]', or name other layers, "
            "such as --layer exact --layer structural"
        ) from None
    if not sets:
        return np.zeros((0, _PERMUTATIONS), np.uint32)
    offsets = np.cumsum([0, *map(len, sets)]).astype(np.uint64)
    flat = _mix(np.concatenate(sets).astype(np.uint64))
    matrix = RMinHash.digest_matrix_from_flat_token_hashes(flat, offsets, _PERMUTATIONS, _SEED)
    return np.array(matrix.to_rows(), np.uint32)


def kernel(sets: Sequence[Shingles]) -> NDArray[np.float64]:
    """The similarity of all pairs as the share of equal MinHash values: within 0.09 of Jaccard for 19 of 20 pairs.

    Unlike rounded Jaccard indices the result is positive semidefinite, as a kernel must be.
    """
    rows = signatures(sets)
    return np.array([(rows == row).mean(axis=1) for row in rows]).reshape(len(rows), len(rows))


def _mix(values: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Spread 64-bit numbers, as the generator SplitMix64 does."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))


def _rows(threshold: float) -> int:
    """How many values a band has: as many as find nearly all pairs at the threshold."""
    for width in (32, 16, 8, 4, 2):
        if 1 - (1 - threshold**width) ** (_PERMUTATIONS // width) >= _RECALL:
            return width
    return 1
