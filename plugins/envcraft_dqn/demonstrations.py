"""Demonstrations, which fill a replay before training."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.replay import Replay
from envcraft_dqn.settings import Settings


class Episode(NamedTuple):
    """Consecutive steps of one episode.

    Attributes:
        frames: The observations before each step and after the last, uint8 [steps + 1, *shape].
        actions: The actions in the form of the environment, [steps, parts].
        rewards: The rewards, [steps].
        terminated: Whether the last step terminated the episode; otherwise it is truncated there.
    """

    frames: NDArray[np.uint8]
    actions: NDArray[Any]
    rewards: NDArray[Any]
    terminated: bool


class DemonstrationSource(Protocol):
    """A source of demonstrations. It may be :class:`Identified`."""

    def episodes(self, name: str) -> Iterable[Episode]:
        """The episodes in an environment, always in the same order."""


@runtime_checkable
class Identified(Protocol):
    """A source with an identity, so that a run resumes only with the same source."""

    def identity(self, names: Sequence[str]) -> str:
        """The identity of the demonstrations in these environments, as text."""


class Adviser(Protocol):
    """A demonstrator that says what it would do in states that it did not bring about."""

    def advise(self, episodes: Sequence[tuple[str, int, NDArray[np.int64]]]) -> Sequence[NDArray[Any] | None]:
        """Label episodes.

        Args:
            episodes: The environment, the seed and the actions [steps, parts] of each episode.

        Returns:
            For each episode, the demonstrator's actions as integers [steps, parts], or the probabilities with which it
            would choose the joint actions, as floats [steps, actions]; None where it gives no advice.

        Raises:
            EnvCraftError: The demonstrator gives no advice at all.
        """


def identity(source: DemonstrationSource, names: Sequence[str]) -> str:
    """The identity of a source, or "some" if it has none."""
    return source.identity(names) if isinstance(source, Identified) else "some"


def seed_replay(
    replay: Replay, spec: EnvSpec, names: Sequence[str], source: DemonstrationSource, settings: Settings
) -> int:
    """Fill an empty replay with demonstrations, label them with their actions, and protect them.

    Args:
        replay: The empty replay.
        spec: The spaces of the environments.
        names: The environments.
        source: The demonstrations.
        settings: The settings, with the number of transitions of each environment.

    Returns:
        The number of transitions.

    Raises:
        UsageError: A demonstration does not match the spaces, there is none, or the replay is too small.
    """
    replay.reset(1)
    count = 0
    for name in names:
        missing = settings.demonstrations
        for episode in source.episodes(name):
            if not missing:
                break
            part = _first(episode, missing)
            steps = len(part.actions)
            # One more slot for the last frame of a truncated episode.
            if replay.added + steps + 1 + settings.online_slots > replay.size:
                raise UsageError(f"a replay of {replay.size:,} is too small for all demonstrations: raise --capacity")
            _add(replay, spec, name, part)
            missing -= steps
            count += steps
    if not count:
        raise UsageError("there are no demonstrations in any of the environments")
    replay.protect()
    return count


def _first(episode: Episode, steps: int) -> Episode:
    """The first steps of an episode, truncated there if it is longer."""
    if len(episode.actions) <= steps:
        return episode
    return Episode(episode.frames[: steps + 1], episode.actions[:steps], episode.rewards[:steps], False)


def _add(replay: Replay, spec: EnvSpec, name: str, episode: Episode) -> None:
    frames, actions, rewards, terminated = episode
    steps = len(actions)
    if frames.shape != (steps + 1, *spec.shape) or frames.dtype != np.uint8 or len(rewards) != steps:
        raise UsageError(
            f"a demonstration of {name} has {len(actions)} actions, {len(rewards)} rewards and frames of "
            f"{frames.dtype} {frames.shape}; expected frames of uint8 {(steps + 1, *spec.shape)}"
        )
    try:
        joint = spec.join(np.asarray(actions))
    except ValueError as error:
        raise UsageError(f"a demonstration of {name} has an invalid action: {error}") from None
    replay.add_episode(frames, joint, np.asarray(rewards, np.float64), terminated, joint)
