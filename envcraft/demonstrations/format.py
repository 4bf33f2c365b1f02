"""The file format of recordings: for each episode its seed, its actions and digests of what they lead to.

A file is MessagePack. Actions are rows of a table, in one byte each for up to 256 different ones. A frame is stored as
eight bytes of its digest. The digest of a whole episode (:func:`envcraft.model.trace.digest`) covers every bit of its
observations, rewards, flags and infos. Playing the actions again gives the frames.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.model.trace import Ending, Trace, digest
from envcraft.text import plural

FORMAT = 2
#: The number of bytes that are stored of a frame's digest.
DIGEST_SIZE = 8


class Episode(msgspec.Struct, array_like=True, frozen=True):
    """One episode of T steps.

    Attributes:
        seed: The seed of the reset.
        steps: T.
        actions: T rows of the table of actions, little-endian integers of `Recording.width` bytes, compressed by zlib.
        rewards: T doubles, compressed by zlib.
        terminated: The flag of the last step.
        truncated: The flag of the last step; both are False for an episode that was cut off.
        frames: T + 1 digests of `DIGEST_SIZE` bytes; the first is that of the reset.
        digest: The digest of the whole trace.
        total: The return.
        success: Whether the episode was won; None if the environment does not say so.
    """

    seed: int
    steps: int
    actions: bytes
    rewards: bytes
    terminated: bool
    truncated: bool
    frames: bytes
    digest: str
    total: float
    success: bool | None


class Recording(msgspec.Struct, frozen=True):
    """The episodes of one player in one environment.

    Attributes:
        source: The SHA-256 of the environment's file.
        env_class: The class; empty for a file with a single one.
        contract: The name of the contract.
        contract_sha256: The digest of the contract.
        player: The name of the player.
        player_digest: Distinguishes players of the same name.
        seed: The seed from which the episodes' seeds derive
            (:meth:`envcraft.judging.probes.Players.episode_seed`).
        table: The different actions, each as JSON.
        episodes: The episodes, in order.
    """

    source: str
    env_class: str
    contract: str
    contract_sha256: str
    player: str
    player_digest: str
    seed: int
    table: list[Any]
    episodes: list[Episode]
    format: int = FORMAT

    @property
    def steps(self) -> int:
        return sum(episode.steps for episode in self.episodes)

    @property
    def width(self) -> int:
        """The number of bytes of an action."""
        return 1 if len(self.table) <= 256 else 4

    def numbers(self, episode: Episode) -> NDArray[np.unsignedinteger[Any]]:
        """The actions of an episode as rows of the table, shape (T,)."""
        return np.frombuffer(zlib.decompress(episode.actions), f"<u{self.width}")

    def actions(self, episode: Episode) -> list[Any]:
        """The actions of an episode."""
        return [self.table[number] for number in self.numbers(episode)]

    def to_bytes(self) -> bytes:
        return msgspec.msgpack.encode(self)

    @classmethod
    def from_bytes(cls, data: bytes) -> Recording:
        """Decode a file. Raises msgspec.DecodeError, and ValueError for another format."""
        recording = msgspec.msgpack.decode(data, type=cls)
        if recording.format != FORMAT:
            raise ValueError(f"it has format {recording.format}, and this version of EnvCraft reads {FORMAT}")
        return recording


class RecordingBuilder:
    """Collects the episodes of a recording.

    Attributes:
        left: The number of steps that are still missing.
    """

    def __init__(self, steps: int) -> None:
        self.left = steps
        self._table: list[Any] = []
        self._rows: dict[bytes, int] = {}
        self._episodes: list[tuple[Trace, NDArray[np.int64]]] = []

    def add(self, trace: Trace) -> None:
        """Add an episode of at most `left` steps, whose actions come from a list."""
        self.left -= trace.steps
        self._episodes.append((trace, np.array([self._row(action) for action in trace.actions[: trace.steps]])))

    def recording(self, **attributes: Any) -> Recording:
        """The recording; `attributes` are the other attributes of :class:`Recording`."""
        width = 1 if len(self._table) <= 256 else 4
        episodes = [_episode(trace, rows, width) for trace, rows in self._episodes]
        return Recording(table=self._table, episodes=episodes, **attributes)

    def _row(self, action: Any) -> int:
        key = msgspec.json.encode(action)
        if key not in self._rows:
            self._rows[key] = len(self._table)
            self._table.append(action)
        return self._rows[key]


def _episode(trace: Trace, rows: NDArray[np.int64], width: int) -> Episode:
    return Episode(
        seed=trace.rollout.seed,
        steps=trace.steps,
        actions=zlib.compress(rows.astype(f"<u{width}").tobytes(), 9),
        rewards=pack_rewards(np.array(trace.rewards)),
        terminated=trace.ending is Ending.TERMINATED,
        truncated=trace.ending is Ending.TRUNCATED,
        frames=frame_digests(trace.observations),
        digest=digest(trace),
        total=trace.total,
        success=trace.success,
    )


def pack_rewards(values: NDArray[np.float64]) -> bytes:
    """Compress rewards of shape (T,) for an episode."""
    return zlib.compress(values.astype("<f8").tobytes(), 9)


def rewards(episode: Episode) -> NDArray[np.float64]:
    """The rewards of an episode, shape (T,)."""
    return np.frombuffer(zlib.decompress(episode.rewards), "<f8")


def frame_digests(observations: Sequence[bytes]) -> bytes:
    """The shortened digests of an episode's frames, for :attr:`Episode.frames`."""
    return b"".join(observation[:DIGEST_SIZE] for observation in observations)


def difference(episode: Episode, trace: Trace) -> str:
    """Describe the first difference between a recorded episode and a trace; empty if they are the same."""
    if digest(trace) == episode.digest:
        return ""
    before, after = episode.frames, frame_digests(trace.observations)
    for step in range(episode.steps + 1):
        at = "the reset" if step == 0 else f"step {step}"
        digests = slice(step * DIGEST_SIZE, (step + 1) * DIGEST_SIZE)
        if before[digests] != after[digests]:
            if step >= len(trace.observations):
                return f"the episode ends after {plural(trace.steps, 'step')}"
            return f"the observation differs at {at}"
        if step and rewards(episode)[step - 1] != trace.rewards[step - 1]:
            return f"the reward differs at {at} ({rewards(episode)[step - 1]:g}, then {trace.rewards[step - 1]:g})"
    ending = (episode.terminated, episode.truncated)
    if ending != (trace.ending is Ending.TERMINATED, trace.ending is Ending.TRUNCATED):
        return f"the episode ends differently: {trace.ending} after {plural(trace.steps, 'step')}"
    return "the infos differ"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
