"""``python -m benchmarks.tetris_players``: episode lengths of random play and of the player `tetris`.

Variants with a drop button are reported separately, because episodes last longer for players that never press it. The
games are generated sources and run in this process. Exit status 1 unless the player wins three quarters of the episodes
that can be won. The player wins as soon as it can, so that its lengths say little where there is a goal.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from envcraft_tetris.family import TetrisFamily
from envcraft_tetris.placement import Placement

MIN_WON = 0.75
_RANDOM_EPISODES = 10


@dataclass(frozen=True)
class Lengths:
    """The results of one variant.

    Attributes:
        drop: Whether a button drops pieces.
        random, player: Episode lengths, in steps.
        won: The outcomes of the player, if the game can be won.
        micros: Processor time per decision of the player, in microseconds.
    """

    drop: bool
    random: list[int]
    player: list[int]
    won: list[bool]
    micros: float

    @property
    def ratio(self) -> float:
        return float(np.mean(self.player) / np.mean(self.random))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variants", type=int, default=60, help="number of variants")
    parser.add_argument("--episodes", type=int, default=3, help="episodes of the player in each variant")
    options = parser.parse_args(arguments)
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for number, generated in enumerate(TetrisFamily().generate(options.variants, 0), 1):
            file = Path(folder, f"{generated.name}.py")
            file.write_text(generated.source, "utf-8")
            controls = generated.metadata["axes"]["controls"]
            results.append(_measure(file, "hard" in (controls["first"], controls["second"]), options.episodes))
            print(f"\r{number} of {options.variants}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return report(results)


def report(results: list[Lengths]) -> int:
    """Print the table; return the exit status."""
    print(f"{'':28}{'10%':>8}{'50%':>8}{'90%':>8}")
    groups = {"all": results, "drop button": [one for one in results if one.drop]}
    groups["no drop button"] = [one for one in results if not one.drop]
    for name, group in groups.items():
        if group:
            _line(f"random steps, {name}", [np.mean(one.random) for one in group])
            _line(f"player steps, {name}", [np.mean(one.player) for one in group])
            _line(f"ratio, {name}", [one.ratio for one in group])
    won = [won for one in results for won in one.won]
    median = float(np.median([one.ratio for one in results]))
    print(f"{len(results)} variants, median ratio {median:.2f}")
    share = float(np.mean(won)) if won else 0.0
    print(f"won {share:.0%} of {len(won)} episodes that can be won (limit: at least {MIN_WON:.0%})")
    print(f"{np.mean([one.micros for one in results]):.0f} microseconds of processor time per decision")
    return 0 if share >= MIN_WON else 1


def _line(name: str, values: list[Any]) -> None:
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
    print(f"{name:28}{low:8.1f}{middle:8.1f}{high:8.1f}")


def _measure(file: Path, drop: bool, episodes: int) -> Lengths:
    env = _load(file)
    rng = np.random.default_rng(0)
    random = [_episode(env, seed, lambda: rng.integers(0, [5, 2, 2]))[0] for seed in range(_RANDOM_EPISODES)]
    player, won, spent = [], [], 0.0
    for seed in range(episodes):
        placement = Placement()

        def act(placement: Placement = placement) -> Any:
            nonlocal spent
            started = time.process_time()
            move = placement.act(env)
            spent += time.process_time() - started
            return np.array(move)

        steps, success = _episode(env, seed, act)
        player.append(steps)
        won += [] if success is None else [success]
    return Lengths(drop, random, player, won, spent / sum(player) * 1e6)


def _load(file: Path) -> Any:
    """The environment of a generated file."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return next(value for name, value in vars(module).items() if name.startswith("Tetris"))()


def _episode(env: Any, seed: int, act: Callable[[], Any]) -> tuple[int, bool | None]:
    """Play an episode; return its length in steps, and its success if the info reports one."""
    env.reset(seed=seed)
    steps = 0
    while True:
        _, _, terminated, truncated, info = env.step(act())
        steps += 1
        if terminated or truncated:
            return steps, info.get("is_success")


if __name__ == "__main__":
    sys.exit(main())
