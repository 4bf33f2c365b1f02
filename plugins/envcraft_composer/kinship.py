"""How alike games are, by the code of their mechanics."""

from __future__ import annotations

import itertools
import textwrap
from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from envcraft.similarity import near
from envcraft_composer.composition import GROUPS
from envcraft_composer.mechanic import Mechanic

#: The groups whose code tells games apart. Each danger and pressure is in so many games that it counts as scaffold.
_TELLING = ("world", "avatar", "goal", "twist")
#: A shingle counts as a mechanic's own if so many mechanics at most have it.
_FEW = 2
#: Shingles of the constants, the name and the look of a game, which no other game has.
_OF_ITS_OWN = 40
#: What it counts that games have one, two or three mechanics in common.
_WEIGHTS = (0, 3, 4, 30)


class Kinship:
    """The games so far, and how much others have in common with them."""

    def __init__(self) -> None:
        shingles = {
            mechanic.name: set().union(*map(_shingles, mechanic.parts.values()))
            for group in _TELLING
            for mechanic in GROUPS[group]
        }
        seen = Counter(itertools.chain.from_iterable(shingles.values()))
        self._sizes = {name: sum(seen[one] <= _FEW for one in found) for name, found in shingles.items()}
        self._numbers = {name: number for number, name in enumerate(shingles)}
        self._games = np.zeros((0, len(_TELLING)), np.int64)
        self._totals = np.zeros(0, np.int64)
        self._used: Counter[frozenset[str]] = Counter()

    def add(self, chosen: Mapping[str, Mechanic]) -> None:
        """Count a game."""
        names = [chosen[group].name for group in _TELLING]
        self._games = np.vstack([self._games, [self._numbers[name] for name in names]])
        self._totals = np.append(self._totals, sum(self._sizes[name] for name in names))
        self._used.update(_subsets(chosen))

    def nearest(self, chosen: Mapping[str, Mechanic]) -> float:
        """An estimate of the Jaccard index of a game's own code with that of the game so far that is most like it."""
        names = [chosen[group].name for group in _TELLING]
        sizes: NDArray[np.int64] = np.array([self._sizes[name] for name in names])
        shared = (self._games == [self._numbers[name] for name in names]) @ sizes
        either = self._totals + sizes.sum() - shared + 2 * _OF_ITS_OWN
        return float(np.max(shared / either, initial=0.0))

    def uses(self, chosen: Mapping[str, Mechanic]) -> int:
        """How often the games so far used these mechanics; those that they have together count more."""
        return sum(_WEIGHTS[len(some)] * self._used[some] for some in _subsets(chosen))


def _shingles(code: str) -> set[int]:
    return set(near.shingles(near.key(textwrap.dedent(code).encode()) or b"").tolist())


def _subsets(chosen: Mapping[str, Mechanic]) -> list[frozenset[str]]:
    """The mechanics of a game: each, each two and each three of them."""
    names = [mechanic.name for mechanic in chosen.values()]
    return [frozenset(some) for size in (1, 2, 3) for some in itertools.combinations(names, size)]
