"""Returns and lengths of whole episodes, with confidence intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft.judging.statistics import Mean
from envcraft_dqn.env_spec import OpenVector, spec_of
from envcraft_dqn.policies import Policy

#: Parallel copies of one environment. More copies wait longer for the longest episodes; fewer make smaller batches.
_COPIES = 16


class Evaluation(msgspec.Struct, frozen=True):
    """The results of one environment.

    Attributes:
        name: The environment.
        episodes: The number of episodes.
        length, total: The mean length in steps and the mean return.
        lengths, returns: The values of each episode, copy by copy.
    """

    name: str
    episodes: int
    length: Mean
    total: Mean
    lengths: list[int]
    returns: list[float]

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
            lengths = [length for copy in own for length, _ in copy]
            returns = [total for copy in own for _, total in copy]
            yield Evaluation(name, episodes, Mean.of(lengths), Mean.of(returns), lengths, returns)


def _play(
    names: Sequence[str], open_vector: OpenVector, policy: Policy, seeds: NDArray[Any], quotas: NDArray[np.int64]
) -> list[list[tuple[int, float]]]:
    """The length and the return of each episode, by environment of the vector."""
    vector = open_vector(names)
    try:
        spec = spec_of(vector, names[0])
        frames, _ = vector.reset(seed=seeds.tolist())
        played: list[list[tuple[int, float]]] = [[] for _ in names]
        lengths, sums = np.zeros(len(names), np.int64), np.zeros(len(names))
        dones = np.zeros(len(names), np.bool_)
        while (active := np.flatnonzero(quotas > 0)).size:
            # Environments that have played their episodes are stepped without the policy.
            actions = np.zeros(len(names), np.int64)
            actions[active] = policy.act(frames[active] if len(active) < len(names) else frames)
            frames, rewards, terminated, truncated, _ = vector.step(spec.split(actions))
            # This step only reset the environments whose episodes had ended.
            lengths[~dones] += 1
            sums += rewards
            dones = terminated | truncated
            for index in np.flatnonzero(dones):
                if quotas[index]:
                    played[index].append((int(lengths[index]), float(sums[index])))
                    quotas[index] -= 1
                lengths[index], sums[index] = 0, 0.0
    finally:
        vector.close()
    return played
