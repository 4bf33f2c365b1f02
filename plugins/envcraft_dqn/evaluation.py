"""How well a player does in environments: returns and lengths of whole episodes, with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from envcraft.errors import UsageError
from envcraft.stats import Mean
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.frames import Frames
from envcraft_dqn.privileged import players
from envcraft_dqn.spaces import OpenVector, Surface, surface_of

#: Lanes that one environment has: more of them wait longer for the longest episodes, fewer make smaller batches.
_COPIES = 16
_AGENT = "agent.safetensors"


class Player(Protocol):
    """Chooses by what is seen."""

    def act(self, frames: Frames) -> NDArray[np.int64]:
        """A joint action for each of `frames`, [n, *shape]."""


class RandomPlayer:
    """Every joint action with the same chance."""

    def __init__(self, surface: Surface, seed: int) -> None:
        self._joint, self._rng = surface.joint, np.random.default_rng([seed, 4])

    def act(self, frames: Frames) -> NDArray[np.int64]:
        return self._rng.integers(0, self._joint, len(frames))


class NoopPlayer:
    """One joint action held: by default the first choice of each part, which under ``arcade`` does nothing."""

    def __init__(self, joint: int = 0) -> None:
        self._joint = joint

    def act(self, frames: Frames) -> NDArray[np.int64]:
        return np.full(len(frames), self._joint, np.int64)


class AgentPlayer:
    """What an agent thinks best, but for a share `epsilon` of random actions; `sha256` is its file's."""

    def __init__(self, path: Path, surface: Surface, seed: int, epsilon: float, device: str = "auto") -> None:
        """Raises UsageError where the file is no agent, or one for other frames or actions."""
        from envcraft_dqn.checkpoint import load_agent
        from envcraft_dqn.learner import device_named

        file = path / _AGENT if path.is_dir() else path
        network, trained = load_agent(file)
        if trained != surface:
            raise UsageError(f"{path} was trained on {trained}, and these environments have {surface}")
        self._device = device_named(device)
        self._network = network.placed(self._device).requires_grad_(False)
        self._random, self._epsilon = RandomPlayer(surface, seed), epsilon
        self._rng = np.random.default_rng([seed, 5])
        self.sha256 = sha256(file.read_bytes()).hexdigest()

    def act(self, frames: Frames) -> NDArray[np.int64]:
        import torch

        pixels = self._network.pixels(torch.from_numpy(frames).to(self._device))
        found: NDArray[np.int64] = self._network.best(pixels).cpu().numpy()
        if not self._epsilon:
            return found
        return np.where(self._rng.random(len(frames)) < self._epsilon, self._random.act(frames), found)


def player_named(name: str, surface: Surface, seed: int, epsilon: float = 0.0, device: str = "auto") -> Player:
    """``random``, ``noop``, or ``checkpoint:PATH``, a folder of ``envcraft train`` or a file. Raises UsageError."""
    if name == "random":
        return RandomPlayer(surface, seed)
    if name == "noop":
        return NoopPlayer()
    kind, _, path = name.partition(":")
    if kind != "checkpoint" or not path:
        there = ", ".join(("random", "noop", "checkpoint:PATH", *players()))
        raise UsageError(f"there is no player {name!r}; there are {there}")
    return AgentPlayer(Path(path), surface, seed, epsilon, device)


class Evaluation(msgspec.Struct, frozen=True):
    """What `episodes` episodes of one environment came to; `returns` and `lengths` lane by lane."""

    name: str
    episodes: int
    length: Mean
    total: Mean
    lengths: list[int]
    returns: list[float]

    def told(self) -> dict[str, Any]:
        """For a file: without the single episodes."""
        return {
            "name": self.name,
            "episodes": self.episodes,
            "length": msgspec.to_builtins(self.length),
            "return": msgspec.to_builtins(self.total),
        }


def evaluate(
    names: Sequence[str], open_vector: OpenVector, player: Player, episodes: int, lanes: int = 64, seed: int = 0
) -> Iterator[Evaluation]:
    """Play `episodes`, at least two, in each environment, as many at a time as there are `lanes`.

    How many episodes a lane plays is settled before: were the first to end taken, short ones would count too much.
    """
    if episodes < 2:
        raise UsageError(f"{episodes} episodes have no standard error: play 2 or more")
    copies = min(_COPIES, lanes, episodes)
    group = max(lanes // copies, 1)
    quotas = np.array([episodes // copies + (lane < episodes % copies) for lane in range(copies)])
    for first in range(0, len(names), group):
        some = names[first : first + group]
        seeds = np.random.SeedSequence([seed, 3, first]).generate_state(len(some) * copies) >> 1
        played = _play(
            [name for name in some for _ in range(copies)], open_vector, player, seeds, np.tile(quotas, len(some))
        )
        for number, name in enumerate(some):
            ours = played[number * copies : (number + 1) * copies]
            lengths = [length for lane in ours for length, _ in lane]
            returns = [total for lane in ours for _, total in lane]
            yield Evaluation(name, episodes, Mean.of(lengths), Mean.of(returns), lengths, returns)


def _play(
    names: Sequence[str], open_vector: OpenVector, player: Player, seeds: NDArray[Any], quotas: NDArray[np.int64]
) -> list[list[tuple[int, float]]]:
    """The length and return of each episode, by lane."""
    vector = open_vector(names)
    try:
        surface = surface_of(vector, names[0])
        frames, _ = vector.reset(seed=seeds.tolist())
        played: list[list[tuple[int, float]]] = [[] for _ in names]
        lengths, sums = np.zeros(len(names), np.int64), np.zeros(len(names))
        over = np.zeros(len(names), np.bool_)
        while (on := np.flatnonzero(quotas > 0)).size:
            # A lane that has played its episodes is stepped along, and nobody has to think for it.
            actions = np.zeros(len(names), np.int64)
            actions[on] = player.act(frames[on] if len(on) < len(names) else frames)
            frames, rewards, terminated, truncated, _ = vector.step(surface.split(actions))
            # A lane whose episode was over has only been reset by this step.
            lengths[~over] += 1
            sums += rewards
            over = terminated | truncated
            for lane in np.flatnonzero(over):
                if quotas[lane]:
                    played[lane].append((int(lengths[lane]), float(sums[lane])))
                    quotas[lane] -= 1
                lengths[lane], sums[lane] = 0, 0.0
    finally:
        vector.close()
    return played


class Played:
    """Demonstrations that a player gives on the spot: of each environment one lane, from a seed of its own."""

    def __init__(self, open_vector: OpenVector, player: Player, steps: int, seed: int = 0) -> None:
        self._open, self._player, self._steps, self._seed = open_vector, player, steps, seed

    def identity(self, names: Sequence[str]) -> str:
        if isinstance(self._player, AgentPlayer):
            return f"the agent {self._player.sha256[:16]}"
        return {RandomPlayer: "random", NoopPlayer: "noop"}.get(type(self._player), "some")

    def episodes(self, name: str) -> Iterator[Episode]:
        """Episodes until there are enough steps; the last one is cut there."""
        vector: Any = self._open([name])
        try:
            surface = surface_of(vector, name)
            left, seed = self._steps, self._seed
            while left > 0:
                seen, _ = vector.reset(seed=[seed])
                frames, actions, rewards, over = [seen[0].copy()], [], [], False
                while not over and left > 0:
                    action = surface.split(self._player.act(seen))
                    seen, reward, terminated, truncated, _ = vector.step(action)
                    frames.append(seen[0].copy())
                    actions.append(action[0])
                    rewards.append(float(reward[0]))
                    over, left = bool(terminated[0] or truncated[0]), left - 1
                yield Episode(np.stack(frames), np.stack(actions), np.array(rewards), bool(terminated[0]))
                seed += 1
        finally:
            vector.close()
