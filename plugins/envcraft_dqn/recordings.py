"""Demonstrations that ``envcraft demos`` recorded as seeds and actions. Frames come from replays or a cache."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.store import CorpusDamaged, Store, demonstrations, environments, find
from envcraft.demonstrations import store as recordings
from envcraft.demonstrations.cache import Cache, CacheDamaged
from envcraft.demonstrations.format import Recording, rewards
from envcraft.errors import UsageError
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.env_spec import OpenVector


class RecordedDemonstrations:
    """The recordings in a corpus.

    Frames come from the cache of the corpus (``envcraft demos --cache``) if it has them; otherwise, the actions are
    replayed.

    Args:
        corpus: The corpus with the recordings.
        open_vector: Makes a vector of named environments, for replays.
        player: The player; by default, the only one.
        seed: The seed of the recordings; by default, any.
        contracts: The digests of the contracts by environment; by default, any contract of any environment.
        player_digest: The version of the player; by default, the only one.

    Attributes:
        names: The environments that have recordings.

    Raises:
        UsageError: There are no recordings, or recordings of several players, versions or contracts.
    """

    def __init__(
        self,
        corpus: Path,
        open_vector: OpenVector,
        player: str | None = None,
        seed: int | None = None,
        contracts: Mapping[str, str] | None = None,
        player_digest: str | None = None,
    ) -> None:
        self._corpus, self._open = find(corpus), open_vector
        self._rows: dict[str, list[demonstrations.Row]] = {}
        with Store(self._corpus) as store:
            by_source: dict[tuple[str, str], list[demonstrations.Row]] = {}
            for _, row in demonstrations.named(store, player):
                if seed in (None, row.seed) and player_digest in (None, row.player_digest):
                    by_source.setdefault((row.source, row.env_class), []).append(row)
            for name, *source in environments.every(store):
                rows = by_source.get((source[0], source[1]), [])
                if rows := [row for row in rows if contracts is None or row.contract_sha256 == contracts.get(name)]:
                    self._rows[name] = rows
        self.names = list(self._rows)
        if not self._rows:
            whose = f" of {player}" if player else ""
            present = sorted({row.contract for rows in by_source.values() for row in rows})
            under = f" under the contract of these environments, only under {' and '.join(present)}" if present else ""
            raise UsageError(f"{corpus} has no recordings{whose}{under}; `envcraft demos {corpus}` makes some")
        for name, rows in self._rows.items():
            self._check_unambiguous(name, rows)

    def _check_unambiguous(self, name: str, rows: Sequence[demonstrations.Row]) -> None:
        """Raises UsageError for recordings of several players, versions of a player, or contracts."""
        players = sorted({row.player for row in rows})
        if len(players) > 1:
            raise UsageError(
                f"{name} has recordings of {' and '.join(players)}: name one, as in {self._corpus}:{players[0]}"
            )
        for what, digests in (
            (f"versions of the player {players[0]}", {row.player_digest for row in rows}),
            ("contracts", {f"{row.contract} {row.contract_sha256}" for row in rows}),
        ):
            if len(digests) > 1:
                raise UsageError(
                    f"{name} has recordings of several {what} in {self._corpus} ({', '.join(sorted(digests))}): record "
                    "the demonstrations into a corpus of their own with `envcraft demos`"
                )

    def steps(self, name: str) -> int:
        """The number of recorded steps in one environment."""
        return sum(row.steps for row in self._rows.get(name, ()))

    def identity(self, names: Sequence[str]) -> str:
        """The players and a digest of the recordings."""
        rows = [(name, row) for name in names for row in self._rows.get(name, ())]
        files = " ".join(f"{name} {row.file}" for name, row in rows)
        players = sorted({row.player for _, row in rows})
        return f"{' and '.join(players)}, recordings {sha256(files.encode()).hexdigest()[:16]}"

    def episodes(self, name: str) -> Iterator[Episode]:
        """The episodes of one environment in the order of their recording.

        Raises:
            CorpusDamaged: The recording or its cache cannot be read.
            UsageError: A replay differs from the recording.
        """
        for row in self._rows.get(name, ()):
            with Store(self._corpus) as store:
                file = recordings.cache_path(store, row.file)
                recording = None if file.exists() else recordings.load(store, row)
            yield from _cached(file) if recording is None else _replayed(recording, name, self._open)


def _cached(file: Path) -> Iterator[Episode]:
    try:
        cache = Cache(file)
    except CacheDamaged as error:
        raise CorpusDamaged(f"the frames {file} cannot be read: the file {error}") from None
    arrays = cache.arrays
    firsts = np.flatnonzero(np.diff(arrays["episode"].astype(np.int64), prepend=-1))
    for first, end in zip(firsts, [*firsts[1:], len(cache)], strict=True):
        numbers = [*arrays["observation"][first:end].tolist(), int(arrays["next_observation"][end - 1])]
        yield Episode(
            np.stack([cache.read(number) for number in numbers]),
            arrays["table"][arrays["action"][first:end]],
            arrays["reward"][first:end],
            bool(arrays["terminated"][end - 1]),
        )


def _replayed(recording: Recording, name: str, open_vector: OpenVector) -> Iterator[Episode]:
    vector: Any = open_vector([name])
    try:
        for number, episode in enumerate(recording.episodes):
            actions, expected = np.array(recording.actions(episode)), rewards(episode)
            frames: list[NDArray[np.uint8]] = [vector.reset(seed=[episode.seed])[0][0].copy()]
            actual: list[float] = []
            done = terminated = False
            while not done and len(actual) < episode.steps:
                seen, reward, terminations, truncations, _ = vector.step(actions[len(actual)][None])
                frames.append(seen[0].copy())
                actual.append(float(reward[0]))
                terminated = bool(terminations[0])
                done = terminated or bool(truncations[0])
            if actual != expected.tolist() or terminated != episode.terminated:
                raise UsageError(
                    f"episode {number} of {recording.player} in {name} does not replay with the recorded rewards; "
                    "`envcraft demos --verify` shows the difference"
                )
            yield Episode(np.stack(frames), actions, expected, terminated)
    finally:
        vector.close()
