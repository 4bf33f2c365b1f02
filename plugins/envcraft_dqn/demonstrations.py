"""Demonstrations: episodes of somebody who plays well, which a replay is seeded with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft_dqn.replay import Replay
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import Surface


class Episode(NamedTuple):
    """Steps of one episode, from its beginning or not, in order.

    Attributes:
        frames: what was seen before each step, and after the last: uint8 [steps + 1, *shape].
        actions: as the environment takes them, [steps, parts].
        rewards: [steps].
        terminated: whether the last step ended the episode for good; otherwise it was cut there.
    """

    frames: NDArray[np.uint8]
    actions: NDArray[Any]
    rewards: NDArray[Any]
    terminated: bool


class DemonstrationSource(Protocol):
    """Where demonstrations come from. It may be :class:`Identified`, too."""

    def episodes(self, name: str) -> Iterable[Episode]:
        """Demonstrations in the environment `name`, in the same order each time."""


@runtime_checkable
class Identified(Protocol):
    """A source that can be told from others, so that a run goes on only with the one that it began with."""

    def identity(self, names: Sequence[str]) -> str:
        """In words, whose demonstrations in these environments they are."""


def identity(source: DemonstrationSource, names: Sequence[str]) -> str:
    """What tells a source from others, as far as it tells."""
    return source.identity(names) if isinstance(source, Identified) else "some"


def seed_replay(
    replay: Replay, surface: Surface, names: Sequence[str], source: DemonstrationSource, settings: Settings
) -> int:
    """Put demonstrations in these environments into an empty replay, to stay, of each environment as many transitions
    as the settings say; give how many in all.

    Raises UsageError where one does not fit the environments, or they leave no room.
    """
    replay.lanes(1)
    count = 0
    for name in names:
        wanted = settings.demonstrations
        for episode in source.episodes(name):
            if not wanted:
                break
            part = _first(episode, wanted)
            steps = len(part.actions)
            # A slot for the frame of a cut.
            if replay.added + steps + 1 + settings.room > replay.size:
                raise UsageError(f"a replay of {replay.size:,} has no room for all demonstrations: raise --capacity")
            _add(replay, surface, name, part)
            wanted -= steps
            count += steps
    if not count:
        raise UsageError("there is no demonstration in any of the environments")
    replay.keep()
    return count


def _first(episode: Episode, steps: int) -> Episode:
    """Its first steps, cut there where it is longer."""
    if len(episode.actions) <= steps:
        return episode
    return Episode(episode.frames[: steps + 1], episode.actions[:steps], episode.rewards[:steps], False)


def _add(replay: Replay, surface: Surface, name: str, episode: Episode) -> None:
    frames, actions, rewards, terminated = episode
    steps = len(actions)
    if frames.shape != (steps + 1, *surface.shape) or frames.dtype != np.uint8 or len(rewards) != steps:
        raise UsageError(
            f"a demonstration of {name} has {len(actions)} actions, {len(rewards)} rewards and frames of "
            f"{frames.dtype} {frames.shape}, where frames of uint8 {(steps + 1, *surface.shape)} are wanted"
        )
    try:
        joint = surface.join(np.asarray(actions))
    except ValueError as error:
        raise UsageError(f"a demonstration of {name} has an action that there is not: {error}") from None
    lane = np.zeros(1, np.int64)
    for step in range(steps):
        last = np.array([step == steps - 1])
        ends, cut = (last & terminated), (last & (not terminated))
        reward = np.array([rewards[step]], np.float64)
        here, there = frames[step : step + 1], frames[step + 1 : step + 2]
        replay.add(lane, here, joint[step : step + 1], reward, ends, cut, there)
