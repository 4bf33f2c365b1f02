"""Returns and lengths of whole episodes, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft.judging.statistics import Mean
from envcraft_dqn.env_spec import OpenVector, spec_of
from envcraft_dqn.policies import Policy

#: Parallel copies of one environment. More copies wait longer for the longest episodes; fewer make smaller batches.
_COPIES = 16
#: The time of a frame in a GIF.
_MILLISECONDS = 50
#: Keys of infos: whether the game is won, and what counts as its goals.
_WON, _GOALS = "is_success", ("lines", "groups", "goals", "score")


class Evaluation(msgspec.Struct, frozen=True):
    """The results of one environment.

    Attributes:
        name: The environment.
        episodes: The number of episodes.
        length, total: The mean length in steps and the mean return.
        lengths, returns: The values of each episode, copy by copy.
        wins: Whether each episode was won, if the infos say so (``is_success``).
        goals: The lines or groups that each episode cleared, if the infos say so.
    """

    name: str
    episodes: int
    length: Mean
    total: Mean
    lengths: list[int]
    returns: list[float]
    wins: list[float] = []
    goals: list[float] = []

    def summary(self) -> dict[str, Any]:
        """The means as plain data, without the values of each episode."""
        return {
            "name": self.name,
            "episodes": self.episodes,
            "length": msgspec.to_builtins(self.length),
            "return": msgspec.to_builtins(self.total),
        }


def evaluate(
    names: Sequence[str], open_vector: OpenVector, policy: Policy, episodes: int, num_envs: int = 64, seed: int = 0
) -> Iterator[Evaluation]:
    """Play whole episodes in each environment.

    The number of episodes of each parallel copy is fixed in advance. Taking the first episodes to end would favour
    short ones.

    Args:
        names: The environments.
        open_vector: Makes a vector of named environments.
        policy: The policy.
        episodes: The episodes of each environment, at least two.
        num_envs: The number of environments to step in parallel.
        seed: The seed of the environments.

    Raises:
        UsageError: There are fewer than two episodes.
    """
    if episodes < 2:
        raise UsageError(f"{episodes} episodes have no standard error: play 2 or more")
    copies = min(_COPIES, num_envs, episodes)
    group = max(num_envs // copies, 1)
    quotas = np.array([episodes // copies + (copy < episodes % copies) for copy in range(copies)])
    for first in range(0, len(names), group):
        some = names[first : first + group]
        seeds = np.random.SeedSequence([seed, 3, first]).generate_state(len(some) * copies) >> 1
        played = _play(
            [name for name in some for _ in range(copies)], open_vector, policy, seeds, np.tile(quotas, len(some))
        )
        for number, name in enumerate(some):
            own = played[number * copies : (number + 1) * copies]
            ends = [end for copy in own for end in copy]
            lengths, returns = [end.length for end in ends], [end.total for end in ends]
            wins, goals = (
                [value for value in values if value is not None]
                for values in ((end.won for end in ends), (end.goals for end in ends))
            )
            yield Evaluation(name, episodes, Mean.of(lengths), Mean.of(returns), lengths, returns, wins, goals)


class _End(NamedTuple):
    """The outcome of an episode."""

    length: int
    total: float
    won: float | None
    goals: float | None


def write_episode(
    file: Path, name: str, open_vector: OpenVector, policy: Policy, seed: int = 0, most: int = 1_000
) -> None:
    """Play one episode and write its frames as an animated GIF.

    Args:
        file: The file.
        name: The environment.
        open_vector: Makes a vector of named environments.
        policy: The policy.
        seed: The seed of the episode.
        most: The most steps.

    Raises:
        UsageError: Pillow is not installed, or the file cannot be written.
    """
    try:
        from PIL import Image
    except ImportError:
        raise UsageError("a GIF needs Pillow; install it with `pip install pillow`") from None
    vector: Any = open_vector([name])
    try:
        spec = spec_of(vector, name)
        seen, _ = vector.reset(seed=[seed])
        pictures, done = [Image.fromarray(seen[0])], False
        while not done and len(pictures) <= most:
            seen, _, terminated, truncated, _ = vector.step(spec.split(policy.act(seen)))
            pictures.append(Image.fromarray(seen[0]))
            done = bool(terminated[0] or truncated[0])
    finally:
        vector.close()
    try:
        pictures[0].save(file, "GIF", save_all=True, append_images=pictures[1:], duration=_MILLISECONDS, loop=0)
    except OSError as error:
        raise UsageError(f"{file} cannot be written: {error.strerror or error}") from None


def _play(
    names: Sequence[str], open_vector: OpenVector, policy: Policy, seeds: NDArray[Any], quotas: NDArray[np.int64]
) -> list[list[_End]]:
    """The outcomes of the episodes, by environment of the vector."""
    vector = open_vector(names)
    try:
        spec = spec_of(vector, names[0])
        frames, _ = vector.reset(seed=seeds.tolist())
        played: list[list[_End]] = [[] for _ in names]
        lengths, sums = np.zeros(len(names), np.int64), np.zeros(len(names))
        dones = np.zeros(len(names), np.bool_)
        while (active := np.flatnonzero(quotas > 0)).size:
            # Environments that have played their episodes are stepped without the policy.
            actions = np.zeros(len(names), np.int64)
            actions[active] = policy.act(frames[active] if len(active) < len(names) else frames)
            frames, rewards, terminated, truncated, infos = vector.step(spec.split(actions))
            # This step only reset the environments whose episodes had ended.
            lengths[~dones] += 1
            sums += rewards
            dones = terminated | truncated
            for index in np.flatnonzero(dones).tolist():
                if quotas[index]:
                    won, goals = _reported(infos, index, _WON), _reported(infos, index, *_GOALS)
                    played[index].append(_End(int(lengths[index]), float(sums[index]), won, goals))
                    quotas[index] -= 1
                lengths[index], sums[index] = 0, 0.0
    finally:
        vector.close()
    return played


def _reported(infos: dict[str, Any], index: int, *keys: str) -> float | None:
    """The value of the first of these keys in the info of one environment of a vector; None if it has none of them."""
    for key in keys:
        if key in infos and infos[f"_{key}"][index]:
            return float(infos[key][index])
    return None
