"""``python -m benchmarks.fastlane_equal``: the fast lane beside the files of the same variants, step by step.

Every frame, reward, flag and info must be the same, bit for bit, and so must the states of the random generators, for
all variants that `envcraft generate --family tetris --count 1000 --seed 0` writes, or as many as ``--count`` says. The
actions are random, and held for a while. Random play clears little and seldom lasts: so games begin with rows that are
nearly full, and some with most of their time over, the same in both.

Exit status 1 when anything differs.
"""

from __future__ import annotations

import argparse
import hashlib
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from envcraft_tetris.family import TetrisFamily
from envcraft_tetris.fastlane.chance import state_of
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from envcraft.families import Generated
from envcraft.using.loading import open_trusted
from envcraft.using.vector import VectorEnv

#: Of actions, the longest that one is held; of games, how often one begins with rows, and how often late.
_HELD, _ROWS_OFTEN, _LATE_OFTEN = 6, 0.7, 0.3
_SHOWN = 5


class Difference(Exception):
    """The two do not do the same."""


class Pair:
    """The file of one variant beside its place in a vector."""

    def __init__(self, generated: Generated, simulator: Any, number: int) -> None:
        source = generated.source.encode()
        digest = hashlib.sha256(source).hexdigest()
        adapted: Any = open_trusted(generated.name, f"{generated.name}.py", source, digest, None, {}, {})
        self.name, self.env = generated.name, adapted.unwrapped
        self._game, self._number = simulator._games[number : number + 1], number
        self._shades = int(simulator._rules["shades"][simulator._which[number]])
        self._ended = False

    def reset(self, seed: int | None, told: tuple[Any, dict[str, Any]], rng: np.random.Generator) -> None:
        """Compare a reset with what the vector has given; then change both alike. Raises Difference."""
        frame, info = self.env.reset(seed=seed)
        self._compare("frame after reset()", np.array_equal(frame, told[0][self._number]))
        self._compare("info after reset()", info == self._info(told[1]))
        self._compare("generator", state_of(self.env.np_random) == self._game["random"][0].tolist())
        self._change(rng)

    def step(self, action: NDArray[np.int64], told: Any, rng: np.random.Generator) -> Counter[str]:
        """Compare a step, and count what happened. Raises Difference."""
        frames, rewards, terminated, truncated, infos = told
        if self._ended:
            self.reset(None, (frames, infos), rng)
            self._ended = False
            return Counter()
        before = self.env.cleared
        frame, reward, lost_or_won, over, info = self.env.step(action)
        number = self._number
        self._compare(f"reward {reward!r}", np.float64(reward).tobytes() == rewards[number].tobytes())
        self._compare("terminated", lost_or_won is bool(terminated[number]))
        self._compare("truncated", over is bool(truncated[number]))
        self._compare("info", info == self._info(infos))
        self._compare("frame", np.array_equal(frame, frames[number]))
        self._ended = lost_or_won or over
        return Counter(
            steps=1,
            cleared=self.env.cleared - before,
            episodes=self._ended,
            won=bool(info.get("is_success")) and self._ended,
            truncated=over,
        )

    def _compare(self, what: str, same: bool) -> None:
        if not same:
            raise Difference(f"{self.name}, step {self.env.steps}: {what}")

    def _info(self, infos: dict[str, Any]) -> dict[str, Any]:
        """What the vector tells of this environment."""
        keys = [key for key in infos if not key.startswith("_") and infos[f"_{key}"][self._number]]
        return {key: infos[key][self._number] for key in keys}

    def _change(self, rng: np.random.Generator) -> None:
        """Lay rows of blocks at the bottom, and let time pass."""
        board, game = self.env.board, self._game[0]
        if rng.random() < _ROWS_OFTEN:
            full = rng.random() ** 0.3
            for y in range(len(board) - int(rng.integers(1, len(board) // 2)), len(board)):
                for x in range(len(board[0])):
                    if board[y][x] == 0 and rng.random() < full:
                        board[y][x] = game["board"][y, x] = 1 + int(rng.integers(self._shades))
            self.env._paint()
        if rng.random() < _LATE_OFTEN:
            self.env.steps = game["steps"] = int(rng.integers(1000))


def actions(rng: np.random.Generator, count: int) -> Iterator[NDArray[np.int64]]:
    """Random actions of so many environments, each held for some steps; buttons are pressed a third of the time."""
    left = np.zeros(count, np.int64)
    action = np.zeros((count, 3), np.int64)
    while True:
        over = left == 0
        fresh = np.column_stack([rng.integers(0, 5, count), rng.random((count, 2)) < 0.33])
        action = np.where(over[:, None], fresh, action).astype(np.int64)
        left = np.where(over, rng.integers(1, _HELD + 1, count), left) - 1
        yield action


def play(generated: Sequence[Generated], steps: int, seed: int) -> tuple[Counter[str], list[str]]:
    """What happened in so many steps of each, and how the two differ, for each variant that is not played alike."""
    simulator: Any = TetrisFamily().simulate(generated)
    vector = VectorEnv([one.name for one in generated], simulator, AutoresetMode.NEXT_STEP, copy=False)
    pairs = {number: Pair(one, simulator, number) for number, one in enumerate(generated)}
    rngs = [np.random.default_rng((seed, number)) for number in pairs]
    happened: Counter[str] = Counter()
    differences: list[str] = []

    def each(call: Any) -> None:
        for number, pair in list(pairs.items()):
            try:
                happened.update(call(number, pair))
            except Difference as difference:
                differences.append(str(difference))
                del pairs[number]

    told: Any = vector.reset(seed=seed)
    each(lambda number, pair: pair.reset(seed + number, told, rngs[number]))
    for _, action in zip(range(steps), actions(np.random.default_rng(seed), len(generated)), strict=False):
        told = vector.step(action)
        each(lambda number, pair: pair.step(action[number], told, rngs[number]))  # noqa: B023 (called at once)
    vector.close()
    return happened, differences


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what was compared and what differs; give 1 if anything does."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fastlane_equal", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="how many variants")
    parser.add_argument("--steps", type=int, default=1000, help="of each")
    parser.add_argument("--seed", type=int, default=0, help="of the family, the games and the actions")
    options = parser.parse_args(arguments)
    started = time.perf_counter()
    happened, differences = play(
        list(TetrisFamily().generate(options.count, options.seed)), options.steps, options.seed
    )
    counts = ", ".join(f"{happened[key]:,} {key}" for key in ("steps", "episodes", "won", "truncated", "cleared"))
    print(f"{options.count:,} variants: {counts}, in {time.perf_counter() - started:.0f} s")
    for line in differences[:_SHOWN]:
        print(f"not the same: {line}")
    print(f"{options.count - len(differences):,} of {options.count:,} are played alike in every step")
    return int(bool(differences))


if __name__ == "__main__":
    raise SystemExit(main())
