"""``python -m benchmarks.vector``: eight different environments side by side, by EnvCraft and by Gymnasium's vectors.

The same eight files, NumPy games of the examples, the benchmarks and the tests' fixtures, are stepped with the same
random actions by ``envcraft.make_vec``, ``AsyncVectorEnv`` (shared memory) and ``SyncVectorEnv``, each with automatic
resets. They take turns in short rounds, in an order that changes, and a ratio is the median of those within one round,
so that other work on the machine hits all three. ``make_vec`` is held to be faster than both: exit status 1 where it is
not. The games take about as long as one another; one that takes many times as long as the rest sets the pace of any
vector, and ``--games`` takes others.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import envcraft

ROOT = Path(__file__).resolve().parent.parent
GAMES = (
    "examples/breakout.py",
    "examples/crossing.py",
    "examples/dungeon.py",
    "examples/invaders.py",
    "examples/snake.py",
    "benchmarks/games/blink.py",
    "tests/fixtures/observation/good/starfield_shooter.py",
    "tests/fixtures/termination/good/many_fuses.py",
)
OURS = "envcraft.make_vec"


def vectors(paths: Sequence[Path]) -> dict[str, Any]:
    """The three, made of the same files."""
    makers = [partial(envcraft.make, path, trust=True) for path in paths]
    return {
        OURS: envcraft.make_vec(list(paths), trust=True),
        "AsyncVectorEnv": AsyncVectorEnv(makers, shared_memory=True),
        "SyncVectorEnv": SyncVectorEnv(makers),
    }


def steps_per_second(vector: Any, actions: NDArray[np.int64]) -> float:
    """Environment steps a second over these actions, continuing whatever episodes are under way."""
    started = time.perf_counter()
    for action in actions:
        vector.step(action)
    return float(actions.shape[0] * actions.shape[1] / (time.perf_counter() - started))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; give 1 where another one is faster."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.vector", description=__doc__)
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--steps", type=int, default=60, help="steps of each in a round")
    parser.add_argument("--games", nargs="+", type=Path, default=[ROOT / game for game in GAMES])
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(0)
    running = vectors(options.games)
    rates: dict[str, list[float]] = {name: [] for name in running}
    try:
        for vector in running.values():
            vector.reset(seed=0)
        orders = itertools.cycle(itertools.permutations(running))
        for number in range(options.rounds + 1):
            actions = rng.integers(0, [5, 2, 2], (options.steps, len(options.games), 3))
            for name in next(orders):
                rate = steps_per_second(running[name], actions)
                # The first round fills caches.
                if number:
                    rates[name].append(rate)
    finally:
        for vector in running.values():
            vector.close()
    ratios = {
        name: statistics.median(ours / theirs for ours, theirs in zip(rates[OURS], found, strict=True))
        for name, found in rates.items()
    }
    table = Table(title=f"{len(options.games)} different environments side by side, {options.rounds} rounds")
    for column in ("", "environment steps/s, median", "least", "most", "make_vec is faster by"):
        table.add_column(column, justify="left" if not column else "right")
    for name, found in rates.items():
        ratio = "" if name == OURS else f"{ratios[name]:.2f}"
        table.add_row(name, *(f"{value:,.0f}" for value in (statistics.median(found), min(found), max(found))), ratio)
    console = Console(width=120)
    console.print(table)
    slower = [name for name, ratio in ratios.items() if name != OURS and ratio <= 1]
    for name in slower:
        console.print(f"limit broken: {name} is faster, {1 / ratios[name]:.2f} times")
    return int(bool(slower))


if __name__ == "__main__":
    raise SystemExit(main())
