"""``python -m benchmarks.vector``: what ``envcraft.make_vec`` costs beside Gymnasium's own vector environments.

``envcraft.make_vec`` is Gymnasium's ``SyncVectorEnv`` or ``AsyncVectorEnv`` (with ``workers``) with named environments
and checked values. All four step the same eight NumPy games with the same random actions and with automatic resets.
They take turns in short rounds, in a varying order, and a ratio is the median of the ratios within one round, so other
work on the machine affects all of them. Each must reach 0.8 times the speed of its counterpart; otherwise the exit
status is 1. ``--games`` selects other games.
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
SYNC, ASYNC = "envcraft.make_vec", "envcraft.make_vec, workers=8"
#: Gymnasium's vector environment that each is compared with.
PEERS = {SYNC: "SyncVectorEnv", ASYNC: "AsyncVectorEnv"}
#: The least speed as a multiple of the peer's.
LIMIT = 0.8


def vectors(paths: Sequence[Path]) -> dict[str, Any]:
    """The four vector environments, made of the same files."""
    makers = [partial(envcraft.make, path, trust=True) for path in paths]
    return {
        SYNC: envcraft.make_vec(list(paths), trust=True),
        PEERS[SYNC]: SyncVectorEnv(makers),
        ASYNC: envcraft.make_vec(list(paths), trust=True, workers=len(paths)),
        PEERS[ASYNC]: AsyncVectorEnv(makers, shared_memory=True),
    }


def steps_per_second(vector: Any, actions: NDArray[np.int64]) -> float:
    """Environment steps a second over these actions, which continue the current episodes."""
    started = time.perf_counter()
    for action in actions:
        vector.step(action)
    return float(actions.shape[0] * actions.shape[1] / (time.perf_counter() - started))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.vector", description=__doc__)
    parser.add_argument("--rounds", type=int, default=60)
    parser.add_argument("--steps", type=int, default=60, help="steps of each per round")
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
        name: statistics.median(ours / theirs for ours, theirs in zip(rates[name], rates[peer], strict=True))
        for name, peer in PEERS.items()
    }
    table = Table(title=f"{len(options.games)} different environments side by side, {options.rounds} rounds")
    for column in ("", "environment steps/s, median", "lowest", "highest", "times Gymnasium's"):
        table.add_column(column, justify="left" if not column else "right")
    for name, measured in rates.items():
        ratio = f"{ratios[name]:.2f}" if name in ratios else ""
        speeds = (statistics.median(measured), min(measured), max(measured))
        table.add_row(name, *(f"{value:,.0f}" for value in speeds), ratio)
    console = Console(width=120)
    console.print(table)
    slower = [name for name, ratio in ratios.items() if ratio < LIMIT]
    for name in slower:
        console.print(f"limit broken: {name} has {ratios[name]:.2f} times the speed of {PEERS[name]}, not {LIMIT}")
    return int(bool(slower))


if __name__ == "__main__":
    raise SystemExit(main())
