"""Compare the vectorized simulator with the generated sources, step by step.

Frames, rewards, flags, infos and the states of the random generators must be equal, bit for bit. Actions are random and
held for a few steps. Random play clears few lines and ends early; so most games start with rows that are nearly full,
and some start late.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from envcraft.environments.families import Generated
from envcraft.environments.loading import open_trusted
from envcraft.environments.vector import NamedVectorEnv
from envcraft_tetris.family import TetrisFamily
from envcraft_tetris.vectorized.pcg64 import state_of

#: The longest time that an action is held, and the shares of games that start with rows and that start late.
_HELD, _ROWS_SHARE, _LATE_SHARE = 6, 0.7, 0.3


class Difference(Exception):
    """The simulator and the source differ."""


class Pair:
    """The environment of one generated source and its index in the simulator."""

    def __init__(self, generated: Generated, simulator: Any, index: int) -> None:
        source = generated.source.encode()
        digest = hashlib.sha256(source).hexdigest()
        adapted: Any = open_trusted(generated.name, f"{generated.name}.py", source, digest, None, {}, {})
        self.name, self.env = generated.name, adapted.unwrapped
        self._game, self._index = simulator._games[index : index + 1], index
        self._shades = int(simulator._rules["shades"][simulator._which[index]])
        self._ended = False

    def reset(self, seed: int | None, result: tuple[Any, dict[str, Any]], rng: np.random.Generator) -> None:
        """Compare a reset, then change both games in the same way. Raises Difference."""
        frame, info = self.env.reset(seed=seed)
        self._compare("frame after reset()", np.array_equal(frame, result[0][self._index]))
        self._compare("info after reset()", info == self._info(result[1]))
        self._compare("generator", state_of(self.env.np_random) == self._game["random"][0].tolist())
        self._change(rng)

    def step(self, action: NDArray[np.int64], result: Any, rng: np.random.Generator) -> Counter[str]:
        """Compare a step, and count its events. Raises Difference."""
        frames, rewards, terminated, truncated, infos = result
        if self._ended:
            self.reset(None, (frames, infos), rng)
            self._ended = False
            return Counter()
        before = self.env.cleared
        frame, reward, game_over, timed_out, info = self.env.step(action)
        index = self._index
        self._compare(f"reward {reward!r}", np.float64(reward).tobytes() == rewards[index].tobytes())
        self._compare("terminated", game_over is bool(terminated[index]))
        self._compare("truncated", timed_out is bool(truncated[index]))
        self._compare("info", info == self._info(infos))
        self._compare("frame", np.array_equal(frame, frames[index]))
        self._ended = game_over or timed_out
        return Counter(
            steps=1,
            cleared=self.env.cleared - before,
            episodes=self._ended,
            won=bool(info.get("is_success")) and self._ended,
            truncated=timed_out,
        )

    def _compare(self, what: str, same: bool) -> None:
        if not same:
            raise Difference(f"{self.name}, step {self.env.steps}: {what}")

    def _info(self, infos: dict[str, Any]) -> dict[str, Any]:
        keys = [key for key in infos if not key.startswith("_") and infos[f"_{key}"][self._index]]
        return {key: infos[key][self._index] for key in keys}

    def _change(self, rng: np.random.Generator) -> None:
        """Fill rows at the bottom, and advance the clock."""
        board, game = self.env.board, self._game[0]
        if rng.random() < _ROWS_SHARE:
            full = rng.random() ** 0.3
            for y in range(len(board) - int(rng.integers(1, len(board) // 2)), len(board)):
                for x in range(len(board[0])):
                    if board[y][x] == 0 and rng.random() < full:
                        board[y][x] = game["board"][y, x] = 1 + int(rng.integers(self._shades))
            self.env._paint()
        if rng.random() < _LATE_SHARE:
            self.env.steps = game["steps"] = int(rng.integers(1000))


def actions(rng: np.random.Generator, num_envs: int) -> Iterator[NDArray[np.int64]]:
    """Yield random actions [num_envs, 3], each held for some steps. A button is pressed a third of the time."""
    left = np.zeros(num_envs, np.int64)
    action = np.zeros((num_envs, 3), np.int64)
    while True:
        expired = left == 0
        fresh = np.column_stack([rng.integers(0, 5, num_envs), rng.random((num_envs, 2)) < 0.33])
        action = np.where(expired[:, None], fresh, action).astype(np.int64)
        left = np.where(expired, rng.integers(1, _HELD + 1, num_envs), left) - 1
        yield action


def compare(generated: Sequence[Generated], steps: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Play generated environments by their sources and by the simulator.

    Args:
        generated: The environments of the family.
        steps: The steps of each.
        seed: The seed of the games and the actions.

    Returns:
        The events, counted over all steps, and the first difference of each environment that has one.
    """
    simulator: Any = TetrisFamily().simulate(generated, AutoresetMode.NEXT_STEP, copy=False)
    vector = NamedVectorEnv(simulator, [one.name for one in generated])
    pairs = {index: Pair(one, simulator, index) for index, one in enumerate(generated)}
    rngs = [np.random.default_rng((seed, index)) for index in pairs]
    events: Counter[str] = Counter()
    differences: list[str] = []

    def for_each(call: Any) -> None:
        for index, pair in list(pairs.items()):
            try:
                events.update(call(index, pair))
            except Difference as difference:
                differences.append(str(difference))
                del pairs[index]

    result: Any = vector.reset(seed=seed)
    for_each(lambda index, pair: pair.reset(seed + index, result, rngs[index]))
    for _, action in zip(range(steps), actions(np.random.default_rng(seed), len(generated)), strict=False):
        result = vector.step(action)
        for_each(lambda index, pair: pair.step(action[index], result, rngs[index]))  # noqa: B023 (called at once)
    vector.close()
    return events, differences
