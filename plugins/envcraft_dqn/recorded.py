"""Demonstrations that ``envcraft demos`` has recorded: seeds and actions, of which the frames are made again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft.corpus.store import CorpusDamaged, Store, find
from envcraft.demonstrations import keeping
from envcraft.demonstrations.cache import Cache, CacheDamaged
from envcraft.demonstrations.form import Recording, rewards
from envcraft.errors import UsageError
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.spaces import OpenVector


class Recorded:
    """The recordings in a corpus. Their frames are those of its cache (``envcraft demos --cache``); where it has none,
    their actions are played again.

    Attributes:
        names: of the environments that have one.
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
        """Look which there are, of one `player` or of the only one, from `seed` or any; with `contracts`, their digests
        by the names of environments, of these alone and as they promise.

        Raises UsageError where there is none, or an environment has those of several players, of several versions of
        one (but for the `player_digest` that is named), or under several contracts.
        """
        self._corpus, self._open = find(corpus), open_vector
        self._rows: dict[str, list[keeping.Row]] = {}
        with Store(self._corpus) as store:
            by_source: dict[tuple[str, str], list[keeping.Row]] = {}
            for _, row in keeping.rows(store, player):
                if seed in (None, row.seed) and player_digest in (None, row.player_digest):
                    by_source.setdefault((row.source, row.env_class), []).append(row)
            for name, *source in store.db.execute("SELECT name, source, class FROM environments ORDER BY name"):
                rows = by_source.get((source[0], source[1]), [])
                if rows := [row for row in rows if contracts is None or row.contract_sha256 == contracts.get(name)]:
                    self._rows[name] = rows
        self.names = list(self._rows)
        if not self._rows:
            whose = f" of {player}" if player else ""
            under = sorted({row.contract for rows in by_source.values() for row in rows})
            other = f" under the contract of these environments, but under {' and '.join(under)}" if under else ""
            raise UsageError(f"{corpus} has no recording{whose}{other}; `envcraft demos {corpus}` makes some")
        for name, rows in self._rows.items():
            players = sorted({row.player for row in rows})
            if len(players) > 1:
                raise UsageError(
                    f"{name} has recordings of {' and '.join(players)}: name one, as in {corpus}:{players[0]}"
                )
            for what, digests in (
                (f"versions of the player {players[0]}", {row.player_digest for row in rows}),
                ("contracts", {f"{row.contract} {row.contract_sha256}" for row in rows}),
            ):
                if len(digests) > 1:
                    raise UsageError(
                        f"{name} has recordings of several {what} in {corpus} ({', '.join(sorted(digests))}): record "
                        "those that you want in a corpus of their own, by `envcraft demos`"
                    )

    def steps(self, name: str) -> int:
        """How many there are in one environment."""
        return sum(row.steps for row in self._rows.get(name, ()))

    def identity(self, names: Sequence[str]) -> str:
        rows = [(name, row) for name in names for row in self._rows.get(name, ())]
        files = " ".join(f"{name} {row.file}" for name, row in rows)
        players = sorted({row.player for _, row in rows})
        return f"{' and '.join(players)}, recordings {sha256(files.encode()).hexdigest()[:16]}"

    def episodes(self, name: str) -> Iterator[Episode]:
        """The episodes of one environment in the order in which they were played; none where it has no recording.

        Raises CorpusDamaged, and where an environment plays otherwise than it did, UsageError.
        """
        for row in self._rows.get(name, ()):
            with Store(self._corpus) as store:
                file = keeping.cache_place(store, row.file)
                recording = None if file.exists() else keeping.read(store, row)
            yield from _cached(file) if recording is None else _played(recording, name, self._open)


def _cached(file: Path) -> Iterator[Episode]:
    try:
        cache = Cache(file)
    except CacheDamaged as error:
        raise CorpusDamaged(f"the frames {file} cannot be read: the file {error}") from None
    arrays = cache.arrays
    firsts = np.flatnonzero(np.diff(arrays["episode"].astype(np.int64), prepend=-1))
    for first, end in zip(firsts, [*firsts[1:], len(cache)], strict=True):
        shown = [*arrays["observation"][first:end].tolist(), int(arrays["next_observation"][end - 1])]
        yield Episode(
            np.stack([cache.read(number) for number in shown]),
            arrays["table"][arrays["action"][first:end]],
            arrays["reward"][first:end],
            bool(arrays["terminated"][end - 1]),
        )


def _played(recording: Recording, name: str, open_vector: OpenVector) -> Iterator[Episode]:
    vector: Any = open_vector([name])
    try:
        for number, episode in enumerate(recording.episodes):
            actions, wanted = np.array(recording.actions(episode)), rewards(episode)
            frames: list[NDArray[np.uint8]] = [vector.reset(seed=[episode.seed])[0][0].copy()]
            found: list[float] = []
            over = terminated = False
            while not over and len(found) < episode.steps:
                seen, reward, terminations, truncations, _ = vector.step(actions[len(found)][None])
                frames.append(seen[0].copy())
                found.append(float(reward[0]))
                terminated = bool(terminations[0])
                over = terminated or bool(truncations[0])
            if found != wanted.tolist() or terminated != episode.terminated:
                raise UsageError(
                    f"{recording.player}'s episode {number} in {name} does not come out again; `envcraft demos "
                    "--verify` tells more"
                )
            yield Episode(np.stack(frames), actions, wanted, terminated)
    finally:
        vector.close()
