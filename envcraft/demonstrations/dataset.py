"""The transitions of a corpus's demonstrations by number, read from the frame caches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.store import CorpusDamaged, Store, demonstrations
from envcraft.demonstrations.cache import Cache, CacheDamaged
from envcraft.demonstrations.store import cache_path
from envcraft.errors import UsageError


class Transition(NamedTuple):
    """One step of an environment."""

    observation: NDArray[Any]
    action: NDArray[Any]
    reward: float
    next_observation: NDArray[Any]
    terminated: bool
    truncated: bool


class Source(NamedTuple):
    """One recording in a data set, with the transitions from `first` to `last`, exclusive."""

    name: str
    player: str
    first: int
    last: int
    cache: Cache


class Demonstrations:
    """The transitions of a corpus's recordings, grouped by environment and in the order of play.

    Frames are decompressed when they are read. The files are mapped into memory, so many processes can share them. One
    thread at a time may use an instance.
    """

    def __init__(self, corpus: Path | str, player: str | None = None, names: Sequence[str] | None = None) -> None:
        """Open the caches of a corpus.

        Args:
            corpus: The corpus.
            player: Only recordings of this player.
            names: Only recordings of these environments.

        Raises:
            UsageError: There is no such recording, or one has no cache.
            CorpusDamaged: A cache is not complete.
        """
        self.sources: list[Source] = []
        first, missing = 0, 0
        with Store(Path(corpus)) as store:
            for name, row in demonstrations.named(store, player):
                if names is not None and name not in names:
                    continue
                file = cache_path(store, row.file)
                if not file.exists():
                    missing += 1
                    continue
                try:
                    cache = Cache(file)
                except CacheDamaged as error:
                    words = f"the frames {file} cannot be read: the file {error}"
                    raise CorpusDamaged(words, f"`envcraft corpus verify {corpus} --repair` removes it") from None
                self.sources.append(Source(name, row.player, first, first + len(cache), cache))
                first += len(cache)
        if missing or not self.sources:
            words = (
                f"{missing:,} recordings in {corpus} have no frame cache" if missing else f"{corpus} has no recording"
            )
            raise UsageError(f"{words}; run `envcraft demos {corpus} --cache`")
        self._firsts = np.array([source.first for source in self.sources])

    def __len__(self) -> int:
        return self.sources[-1].last

    def source(self, number: int) -> Source:
        """The recording of a transition. Raises IndexError."""
        if not 0 <= number < len(self):
            raise IndexError(f"there is no transition {number}, only {len(self)}")
        return self.sources[int(np.searchsorted(self._firsts, number, "right")) - 1]

    def transition(self, number: int) -> Transition:
        """The transition with this number, from 0. Raises IndexError."""
        source = self.source(number)
        cache, step = source.cache, number - source.first
        arrays = cache.arrays
        return Transition(
            cache.read(arrays["observation"][step]),
            arrays["table"][arrays["action"][step]],
            float(arrays["reward"][step]),
            cache.read(arrays["next_observation"][step]),
            bool(arrays["terminated"][step]),
            bool(arrays["truncated"][step]),
        )

    def read(
        self,
        numbers: Sequence[int] | NDArray[np.integer[Any]],
        observations: NDArray[Any] | None = None,
        next_observations: NDArray[Any] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Read a batch of B transitions.

        Args:
            numbers: Their numbers, shape (B,).
            observations: An array of shape (B, *frame) for the frames before the steps; None to skip them.
            next_observations: The same for the frames after the steps.

        Returns:
            ``action`` of shape (B, ...), and ``reward``, ``terminated``, ``truncated`` of shape (B,).

        Raises:
            IndexError: A number does not exist.
        """
        rows: dict[str, list[Any]] = {"action": [], "reward": [], "terminated": [], "truncated": []}
        for row, number in enumerate(np.asarray(numbers).tolist()):
            source = self.source(number)
            cache, step = source.cache, number - source.first
            arrays = cache.arrays
            if observations is not None:
                observations[row] = cache.read(arrays["observation"][step])
            if next_observations is not None:
                next_observations[row] = cache.read(arrays["next_observation"][step])
            rows["action"].append(arrays["table"][arrays["action"][step]])
            for name in ("reward", "terminated", "truncated"):
                rows[name].append(arrays[name][step])
        return {
            "action": np.array(rows["action"]),
            "reward": np.array(rows["reward"]),
            "terminated": np.array(rows["terminated"], bool),
            "truncated": np.array(rows["truncated"], bool),
        }
