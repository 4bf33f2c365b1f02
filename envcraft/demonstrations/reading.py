"""Demonstrations as a learner reads them: transitions of many environments by number, from the caches of a corpus."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.store import CorpusDamaged, Store
from envcraft.demonstrations import keeping
from envcraft.demonstrations.cache import Cache, CacheDamaged
from envcraft.errors import UsageError


class Transition(NamedTuple):
    """What one step did: `action` is a row of the recording's table."""

    observation: NDArray[Any]
    action: NDArray[Any]
    reward: float
    next_observation: NDArray[Any]
    terminated: bool
    truncated: bool


class Source(NamedTuple):
    """One recording among several: transitions `first` up to `last`, the latter not included."""

    name: str
    player: str
    first: int
    last: int
    cache: Cache


class Demonstrations:
    """The transitions of a corpus's recordings, those of one environment in a row and in the order of play.

    Frames are decompressed as they are asked for; the files are mapped into memory, so that any number of processes can
    share them. Safe to use from one thread at a time.
    """

    def __init__(self, corpus: Path | str, player: str | None = None, names: Sequence[str] | None = None) -> None:
        """Open the caches of a corpus: of one `player`'s recordings, and of the environments in `names`, or of all.

        Raises UsageError where there is none, or one was not made, CorpusDamaged where one is not what it was.
        """
        self.sources: list[Source] = []
        first, missing = 0, 0
        with Store(Path(corpus)) as store:
            for name, row in keeping.rows(store, player):
                if names is not None and name not in names:
                    continue
                file = keeping.cache_place(store, row.file)
                if not file.exists():
                    missing += 1
                    continue
                try:
                    cache = Cache(file)
                except CacheDamaged as error:
                    words = f"the frames {file} cannot be read: the file {error}"
                    raise CorpusDamaged(words, f"`envcraft corpus verify {corpus} --repair` takes it out") from None
                self.sources.append(Source(name, row.player, first, first + len(cache), cache))
                first += len(cache)
        if missing or not self.sources:
            words = f"{missing:,} recordings in {corpus} have no frames" if missing else f"{corpus} has no recording"
            raise UsageError(f"{words}; `envcraft demos {corpus} --cache` makes them")
        self._firsts = np.array([source.first for source in self.sources])

    def __len__(self) -> int:
        return self.sources[-1].last

    def source(self, number: int) -> Source:
        """The recording that a transition is from. Raises IndexError."""
        if not 0 <= number < len(self):
            raise IndexError(f"there is no transition {number}, only {len(self)}")
        return self.sources[int(np.searchsorted(self._firsts, number, "right")) - 1]

    def transition(self, number: int) -> Transition:
        """A transition by its number, from 0. Raises IndexError."""
        source = self.source(number)
        cache, place = source.cache, number - source.first
        arrays = cache.arrays
        return Transition(
            cache.read(arrays["observation"][place]),
            arrays["table"][arrays["action"][place]],
            float(arrays["reward"][place]),
            cache.read(arrays["next_observation"][place]),
            bool(arrays["terminated"][place]),
            bool(arrays["truncated"][place]),
        )

    def read(
        self,
        numbers: Sequence[int] | NDArray[np.integer[Any]],
        observations: NDArray[Any] | None = None,
        next_observations: NDArray[Any] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Read B transitions: their frames into the arrays that are given, each of shape (B, *frame); the rest is given
        back: ``action`` of shape (B, ...), ``reward``, ``terminated``, ``truncated`` of shape (B,).

        Raises IndexError.
        """
        rows: dict[str, list[Any]] = {"action": [], "reward": [], "terminated": [], "truncated": []}
        for place, number in enumerate(np.asarray(numbers).tolist()):
            source = self.source(number)
            cache, step = source.cache, number - source.first
            arrays = cache.arrays
            if observations is not None:
                observations[place] = cache.read(arrays["observation"][step])
            if next_observations is not None:
                next_observations[place] = cache.read(arrays["next_observation"][step])
            rows["action"].append(arrays["table"][arrays["action"][step]])
            for name in ("reward", "terminated", "truncated"):
                rows[name].append(arrays[name][step])
        return {
            "action": np.array(rows["action"]),
            "reward": np.array(rows["reward"]),
            "terminated": np.array(rows["terminated"], bool),
            "truncated": np.array(rows["truncated"], bool),
        }
