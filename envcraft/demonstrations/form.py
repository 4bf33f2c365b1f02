"""The canonical form of demonstrations: for each episode its seed and actions, and what has to come out of them.

A file is MessagePack. Actions are numbers in a table, a byte each where there are no more than 256; a frame is eight
bytes of its digest, and the whole trajectory has a digest of its own (:func:`envcraft.trace.digest`), which stands for
every bit of observations, rewards, flags and infos. Playing the actions again gives the frames.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.trace import Ending, Trace, digest

FORMAT = 2
#: Bytes of a frame's digest that are kept.
FRAME = 8


class Episode(msgspec.Struct, array_like=True, frozen=True):
    """One episode of T steps.

    Attributes:
        seed: of the reset.
        steps: T.
        actions: T numbers in the table of actions, as little-endian integers of `Recording.width` bytes, compressed.
        rewards: T floats, compressed by zlib.
        terminated: whether the last step ended the episode; likewise `truncated`. Neither where it was cut.
        frames: T + 1 digests of `FRAME` bytes; the first is that of the reset.
        digest: of the whole trace.
        total: the return.
        success: whether it was won; None where nothing tells.
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
    """What one player did in one environment.

    Attributes:
        source: the SHA-256 of the environment's file; `env_class` is empty unless that has several.
        contract: its name and `contract_sha256` the digest of what it promises.
        player: its name and `player_digest` what tells it from another of that name.
        seed: that of the episodes' seeds (:meth:`envcraft.players.Players.episode_seed`).
        table: the actions that occur, each as JSON.
        episodes: in the order of their numbers.
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
        """Bytes of an action's number."""
        return 1 if len(self.table) <= 256 else 4

    def numbers(self, episode: Episode) -> NDArray[np.unsignedinteger[Any]]:
        """The actions of an episode as numbers in the table, shape (T,)."""
        return np.frombuffer(zlib.decompress(episode.actions), f"<u{self.width}")

    def actions(self, episode: Episode) -> list[Any]:
        """The actions of an episode."""
        return [self.table[number] for number in self.numbers(episode)]

    def to_bytes(self) -> bytes:
        return msgspec.msgpack.encode(self)

    @classmethod
    def from_bytes(cls, data: bytes) -> Recording:
        """Raises msgspec.DecodeError on what is no recording, ValueError on one of another format."""
        found = msgspec.msgpack.decode(data, type=cls)
        if found.format != FORMAT:
            raise ValueError(f"format {found.format}, and this version of EnvCraft reads {FORMAT}")
        return found


class Recorder:
    """Puts episodes together to a recording of `steps` steps."""

    def __init__(self, steps: int) -> None:
        self.left = steps
        self._table: list[Any] = []
        self._numbers: dict[bytes, int] = {}
        self._parts: list[tuple[Trace, NDArray[np.int64]]] = []

    def add(self, trace: Trace) -> None:
        """Take in a trace of no more than `left` steps, whose actions come from a list."""
        self.left -= trace.steps
        self._parts.append((trace, np.array([self._number(action) for action in trace.actions[: trace.steps]])))

    def recording(self, **about: Any) -> Recording:
        """What was taken in; `about` are the other attributes of :class:`Recording`."""
        width = 1 if len(self._table) <= 256 else 4
        episodes = [_episode(trace, numbers, width) for trace, numbers in self._parts]
        return Recording(table=self._table, episodes=episodes, **about)

    def _number(self, action: Any) -> int:
        key = msgspec.json.encode(action)
        if key not in self._numbers:
            self._numbers[key] = len(self._table)
            self._table.append(action)
        return self._numbers[key]


def _episode(trace: Trace, numbers: NDArray[np.int64], width: int) -> Episode:
    return Episode(
        seed=trace.rollout.seed,
        steps=trace.steps,
        actions=zlib.compress(numbers.astype(f"<u{width}").tobytes(), 9),
        rewards=packed(np.array(trace.rewards)),
        terminated=trace.ending is Ending.TERMINATED,
        truncated=trace.ending is Ending.TRUNCATED,
        frames=frame_digests(trace.observations),
        digest=digest(trace),
        total=trace.total,
        success=trace.success,
    )


def packed(values: NDArray[np.float64]) -> bytes:
    """Rewards of shape (T,), as an episode keeps them."""
    return zlib.compress(values.astype("<f8").tobytes(), 9)


def rewards(episode: Episode) -> NDArray[np.float64]:
    """The rewards of an episode, shape (T,)."""
    return np.frombuffer(zlib.decompress(episode.rewards), "<f8")


def frame_digests(observations: Sequence[bytes]) -> bytes:
    """What an episode keeps of its frames' digests."""
    return b"".join(observation[:FRAME] for observation in observations)


def difference(episode: Episode, trace: Trace) -> str:
    """The first thing in which a trace is not what was recorded, in words; empty where it is the same."""
    if digest(trace) == episode.digest:
        return ""
    shown, found = episode.frames, frame_digests(trace.observations)
    for step in range(episode.steps + 1):
        at = "the reset" if step == 0 else f"step {step}"
        if shown[step * FRAME : (step + 1) * FRAME] != found[step * FRAME : (step + 1) * FRAME]:
            ended = step >= len(trace.observations)
            return f"the episode ends after {trace.steps} steps" if ended else f"the observation differs at {at}"
        if step and rewards(episode)[step - 1] != trace.rewards[step - 1]:
            return f"the reward differs at {at} ({rewards(episode)[step - 1]:g}, then {trace.rewards[step - 1]:g})"
    ending = (episode.terminated, episode.truncated)
    if ending != (trace.ending is Ending.TERMINATED, trace.ending is Ending.TRUNCATED):
        return f"the episode ends otherwise: {trace.ending} after {trace.steps} steps"
    return "the infos differ"


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
