"""How long random play and the player `tetris` last in games of the family, in steps:
``python -m benchmarks.tetris_players [--variants 60] [--episodes 3]``.

Variants of which a button drops pieces are told apart, since who leaves the button alone lasts longer there. The games
are this repository's own files, and run in this process. Exits with 1 where the player does not last five times as long
as random play does, by the median over the variants.
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

LEAST = 5.0
_RANDOM = 10


@dataclass(frozen=True)
class Played:
    """One variant: steps of random episodes and of the player's, how many of the latter were won where that is told,
    and the processor time of one of its decisions in microseconds.
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
    parser.add_argument("--variants", type=int, default=60)
    parser.add_argument("--episodes", type=int, default=3)
    chosen = parser.parse_args(arguments)
    played = []
    with tempfile.TemporaryDirectory() as folder:
        for number, written in enumerate(TetrisFamily().generate(chosen.variants, 0), 1):
            file = Path(folder, f"{written.name}.py")
            file.write_text(written.source, "utf-8")
            controls = written.metadata["axes"]["controls"]
            played.append(_play(file, "hard" in (controls["first"], controls["second"]), chosen.episodes))
            print(f"\r{number} of {chosen.variants}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return report(played)


def report(played: list[Played]) -> int:
    """Print the figures; the exit status."""
    print(f"{'':28}{'10%':>8}{'50%':>8}{'90%':>8}")
    groups = {"all": played, "a button drops": [one for one in played if one.drop]}
    groups["none does"] = [one for one in played if not one.drop]
    for words, found in groups.items():
        if found:
            _line(f"random steps, {words}", [np.mean(one.random) for one in found])
            _line(f"player steps, {words}", [np.mean(one.player) for one in found])
            _line(f"ratio, {words}", [one.ratio for one in found])
    won = [won for one in played for won in one.won]
    median = float(np.median([one.ratio for one in played]))
    print(f"{len(played)} variants, median ratio {median:.2f} (at least {LEAST:g})")
    print(f"won {np.mean(won):.0%} of {len(won)} episodes that can be won" if won else "no episode can be won")
    print(f"{np.mean([one.micros for one in played]):.0f} microseconds of processor time for a decision")
    return 0 if median >= LEAST else 1


def _line(words: str, values: list[Any]) -> None:
    low, middle, high = np.quantile(values, (0.1, 0.5, 0.9))
    print(f"{words:28}{low:8.1f}{middle:8.1f}{high:8.1f}")


def _play(file: Path, drop: bool, episodes: int) -> Played:
    env = _made(file)
    rng = np.random.default_rng(0)
    random = [_episode(env, seed, lambda: rng.integers(0, [5, 2, 2]))[0] for seed in range(_RANDOM)]
    player, won, spent = [], [], 0.0
    for seed in range(episodes):
        placement = Placement()

        def choose(placement: Placement = placement) -> Any:
            nonlocal spent
            started = time.process_time()
            move = placement.act(env)
            spent += time.process_time() - started
            return np.array(move)

        steps, told = _episode(env, seed, choose)
        player.append(steps)
        won += [] if told is None else [told]
    return Played(drop, random, player, won, spent / sum(player) * 1e6)


def _made(file: Path) -> Any:
    """An environment of a file that this program wrote."""
    spec = importlib.util.spec_from_file_location(file.stem, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return next(value for name, value in vars(module).items() if name.startswith("Tetris"))()


def _episode(env: Any, seed: int, choose: Callable[[], Any]) -> tuple[int, bool | None]:
    """Steps, and whether it was won where that is told."""
    env.reset(seed=seed)
    steps = 0
    while True:
        _, _, terminated, truncated, info = env.step(choose())
        steps += 1
        if terminated or truncated:
            return steps, info.get("is_success")


if __name__ == "__main__":
    sys.exit(main())
