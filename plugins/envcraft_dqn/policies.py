"""Policies that act on frames alone, in batches."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft.registry import did_you_mean, offered
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.frames import Frames

#: The names of policies, which take precedence over players of plugins.
NAMES = ("random", "noop")
_AGENT = "agent.safetensors"


class Policy(Protocol):
    """Maps frames to actions."""

    def act(self, frames: Frames) -> NDArray[np.int64]:
        """The joint actions [n] for `frames` [n, *shape]."""


class RandomPolicy:
    """Uniformly random joint actions."""

    def __init__(self, spec: EnvSpec, seed: int) -> None:
        self._num_actions, self._rng = spec.num_actions, np.random.default_rng([seed, 4])

    def act(self, frames: Frames) -> NDArray[np.int64]:
        return self._rng.integers(0, self._num_actions, len(frames))


class NoopPolicy:
    """One constant joint action: by default 0 in each component, which is the no-op of the contract ``arcade``."""

    def __init__(self, joint: int = 0) -> None:
        self._joint = joint

    def act(self, frames: Frames) -> NDArray[np.int64]:
        return np.full(len(frames), self._joint, np.int64)


class CoinPolicy:
    """Random values of the first component, and 0 of all others: in the contract ``arcade`` random moves without
    buttons. It lasts where buttons cost, without a look at the frame.
    """

    def __init__(self, spec: EnvSpec, seed: int) -> None:
        self._choices, self._rest = spec.choices[0], spec.num_actions // spec.choices[0]
        self._rng = np.random.default_rng([seed, 6])

    def act(self, frames: Frames) -> NDArray[np.int64]:
        return self._rng.integers(0, self._choices, len(frames)) * self._rest


class ShuffledPolicy:
    """Random joint actions at given frequencies: those of another policy, without its look at the frame.

    Args:
        counts: How often the other policy chose each joint action.
        seed: The seed.
    """

    def __init__(self, counts: Sequence[int], seed: int) -> None:
        self._chances = np.asarray(counts, np.float64) / np.sum(counts)
        self._rng = np.random.default_rng([seed, 7])

    def act(self, frames: Frames) -> NDArray[np.int64]:
        return self._rng.choice(len(self._chances), len(frames), p=self._chances)


class CountingPolicy:
    """A policy, and how often it chose each joint action (`counts`)."""

    def __init__(self, policy: Policy, num_actions: int) -> None:
        self._policy, self.counts = policy, np.zeros(num_actions, np.int64)

    def act(self, frames: Frames) -> NDArray[np.int64]:
        actions = self._policy.act(frames)
        self.counts += np.bincount(actions, minlength=len(self.counts))
        return actions


class AgentPolicy:
    """The actions of a trained agent, replaced by random actions at the rate `epsilon`.

    An agent that was trained with a temperature draws its actions; others are greedy.

    Args:
        path: The file of the agent, or the folder of ``envcraft train``.
        spec: The spaces of the environments.
        seed: The seed of random actions and of drawn ones.
        epsilon: The rate of random actions.
        device: A torch device, or ``auto``.

    Attributes:
        sha256: The digest of the file.

    Raises:
        UsageError: The file is not an agent for these spaces.
    """

    def __init__(self, path: Path, spec: EnvSpec, seed: int, epsilon: float, device: str = "auto") -> None:
        from envcraft_dqn.checkpoint import load_agent
        from envcraft_dqn.learner import device_named

        file = agent_file(path)
        network, trained = load_agent(file)
        if trained != spec:
            raise UsageError(f"{path} was trained on {trained}, but these environments have {spec}")
        self._device = device_named(device)
        self._network = network.on_device(self._device).requires_grad_(False)
        self._spec, self._epsilon = spec, epsilon
        self.restart(seed)
        self.sha256 = sha256(file.read_bytes()).hexdigest()

    def restart(self, seed: int) -> None:
        """Start the random numbers over from a seed."""
        self._random = RandomPolicy(self._spec, seed)
        self._rng = np.random.default_rng([seed, 5])

    def act(self, frames: Frames) -> NDArray[np.int64]:
        import torch

        pixels = self._network.preprocess(torch.from_numpy(frames).to(self._device))
        actions = self._network.choose(self._network.advantages(pixels), self._rng)
        if not self._epsilon:
            return actions
        return np.where(self._rng.random(len(frames)) < self._epsilon, self._random.act(frames), actions)


def agent_file(path: Path) -> Path:
    """The file of an agent, from its path or that of the folder of ``envcraft train``."""
    return path / _AGENT if path.is_dir() else path


def policy_named(name: str, spec: EnvSpec, seed: int, epsilon: float = 0.0, device: str = "auto") -> Policy:
    """Make a policy by name: ``random``, ``noop``, or ``checkpoint:PATH`` as for :class:`AgentPolicy`.

    Raises:
        UsageError: There is no such policy.
    """
    if name == "random":
        return RandomPolicy(spec, seed)
    if name == "noop":
        return NoopPolicy()
    kind, _, path = name.partition(":")
    if kind != "checkpoint" or not path:
        players = [player.name for player in offered("envcraft_players") if player.name not in NAMES]
        raise UsageError(f"there is no player {did_you_mean(name, [*NAMES, 'checkpoint:PATH', *players])}")
    return AgentPolicy(Path(path), spec, seed, epsilon, device)
