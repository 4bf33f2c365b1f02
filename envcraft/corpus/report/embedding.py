"""The map of a corpus: environments in the plane, near each other if their sources and their behaviour are alike.

An environment is a vector of two parts of equal length: the words of its source, hashed and weighted by their rarity,
and the fingerprint of its behaviour. The plane is that of the first two principal components.
"""

from __future__ import annotations

import heapq
import re
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.report.data import Entry
from envcraft.similarity.behavioural import STEPS, read

#: How many environments are shown, those with the lowest digests of their sources: a sample that a rerun repeats.
MOST = 1_000
#: Fewer environments make no map.
FEWEST = 4
_WORDS, _BITS = 512, 64
_WORD = re.compile(r"[A-Za-z_]\w+")


class Point(NamedTuple):
    """An environment on the map, with coordinates from 0 to 1."""

    number: int
    outcome: str
    x: float
    y: float


class Embedding:
    """Collects the vectors of environments."""

    def __init__(self) -> None:
        #: The negative of the digest, so that the highest one is removed first.
        self._kept: list[tuple[int, int, str, NDArray[np.float32]]] = []

    def add(self, entry: Entry, source: str) -> None:
        """Add an environment with this source."""
        rank = -int(entry.environment.source[:15], 16)
        if len(self._kept) == MOST and rank < self._kept[0][0]:
            return
        item = (rank, entry.number, entry.outcome, np.concatenate([_words(source), _behaviour(entry)]))
        (heapq.heappushpop if len(self._kept) == MOST else heapq.heappush)(self._kept, item)

    def points(self) -> list[Point]:
        """The map; empty for few environments, or if all are the same."""
        if len(self._kept) < FEWEST:
            return []
        kept = sorted(self._kept, key=lambda item: item[1])
        matrix = np.stack([vector for *_, vector in kept]).astype(np.float64)
        words = matrix[:, :_WORDS]
        # A word that all have says nothing.
        words *= np.log((1 + len(kept)) / (1 + np.count_nonzero(words, axis=0)))
        for part in (words, matrix[:, _WORDS:]):
            lengths = np.linalg.norm(part, axis=1, keepdims=True)
            part /= np.where(lengths > 0, lengths, 1)
        matrix -= matrix.mean(axis=0)
        left, sizes, _ = np.linalg.svd(matrix, full_matrices=False)
        if sizes[0] < 1e-9:
            return []
        plane = left[:, :2] * sizes[:2]
        # The sign of a component is arbitrary.
        plane *= np.where(plane[np.abs(plane).argmax(axis=0), [0, 1]] < 0, -1, 1)
        low, high = plane.min(axis=0), plane.max(axis=0)
        plane = (plane - low) / np.where(high > low, high - low, 1)
        return [
            Point(number, outcome, round(float(x), 4), round(float(y), 4))
            for (_, number, outcome, _), (x, y) in zip(kept, plane, strict=True)
        ]


def _words(source: str) -> NDArray[np.float32]:
    counts = np.zeros(_WORDS, np.float32)
    for word in _WORD.findall(source):
        counts[zlib.crc32(word.encode()) % _WORDS] += 1
    return np.log1p(counts)


def _behaviour(entry: Entry) -> NDArray[np.float32]:
    """The mean of the bits of all frames, the length of the episode, and how often it pays; zeros if unknown."""
    vector = np.zeros(_BITS + 2, np.float32)
    series = None if entry.report is None else read(entry.report.fingerprint)
    if series is None or not len(series.frames):
        return vector
    bits = np.unpackbits(series.frames.astype("<u8").view(np.uint8).reshape(len(series.frames), -1), axis=1)
    vector[:_BITS] = bits.mean(axis=0) * 2 - 1
    vector[_BITS] = series.steps / STEPS
    vector[_BITS + 1] = float((series.rewards != 0).mean()) if len(series.rewards) else 0.0
    return vector
