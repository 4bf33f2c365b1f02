"""Measures the small families: how often the player, random play and doing nothing win, and the steps per second.

Prints a line for each family and exits with status 1 if a limit is missed. ``--variants 200 --episodes 10`` measures
the figures of the documentation; the default is a sample.
"""

from __future__ import annotations

import argparse
import sys
import time
import types
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from envcraft_families.families import families
from envcraft_families.players import players

from envcraft.demonstrations.player import PolicyPlayer

#: The shares of variants, at least, on which random play wins at most 20% and the player at least 90%.
RANDOM_SHARE, PLAYER_SHARE = 0.9, 0.95
RANDOM_WINS, PLAYER_WINS = 0.2, 0.9
STEPS_PER_SECOND = 5000


@dataclass(frozen=True)
class Played:
    """The results of one variant: the shares of episodes won, the player's steps, and random steps per second."""

    random: float
    player: float
    idle: bool
    steps: float
    speed: float


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variants", type=int, default=20, help="number of variants of each family")
    parser.add_argument("--episodes", type=int, default=3, help="episodes of the player in each variant")
    parser.add_argument("--difficulty", type=float, help="the difficulty of all variants")
    options = parser.parse_args(arguments)
    by_name = {player.name: player for player in players()}
    print(f"{'family':10}{'random <= 20%':>15}{'player >= 90%':>15}{'idle wins':>11}{'steps':>7}{'steps/s':>9}")
    missed = 0
    for family in families():
        generated = family.generate(options.variants, 0, options.difficulty)
        results = [measure(one.source, by_name[family.name], options.episodes) for one in generated]
        random = float(np.mean([one.random <= RANDOM_WINS for one in results]))
        player = float(np.mean([one.player >= PLAYER_WINS for one in results]))
        idle, speed = sum(one.idle for one in results), float(np.median([one.speed for one in results]))
        steps = np.mean([one.steps for one in results])
        print(f"{family.name:10}{random:15.1%}{player:15.1%}{idle:11}{steps:7.0f}{speed:9,.0f}")
        # A difficulty that is set may be easy.
        easy = options.difficulty is None and random < RANDOM_SHARE
        missed += easy or player < PLAYER_SHARE or idle > 0 or speed < STEPS_PER_SECOND
    print(
        f"limits: {RANDOM_SHARE:.0%} of the variants for random play, {PLAYER_SHARE:.0%} for the player, no win by "
        f"doing nothing, {STEPS_PER_SECOND:,} steps/s with frames"
    )
    return int(missed > 0)


def measure(source: str, player: PolicyPlayer, episodes: int) -> Played:
    """Play a variant in this process. The source is one that this repository's families wrote."""
    env = _load(source)
    rng = np.random.default_rng(0)
    started = time.process_time()
    lucky = [_episode(env, seed, lambda: rng.integers(0, [5, 2, 2])) for seed in range(4 * episodes)]
    spent = time.process_time() - started
    idle = [_episode(env, seed, lambda: (0, 0, 0)) for seed in range(2)]
    won = []
    for seed in range(episodes):
        policy = _policy(player)
        won.append(_episode(env, seed, partial(policy.act, env)))
    return Played(
        random=float(np.mean([success for _, success in lucky])),
        player=float(np.mean([success for _, success in won])),
        idle=any(success for _, success in idle),
        steps=float(np.mean([steps for steps, _ in won])),
        speed=sum(steps for steps, _ in lucky) / max(spent, 1e-9),
    )


def _load(source: str) -> Any:
    module = types.ModuleType("variant")
    exec(compile(source, "variant.py", "exec"), vars(module))
    return next(value for value in vars(module).values() if isinstance(value, type) and issubclass(value, gym.Env))()


def _policy(player: PolicyPlayer) -> Any:
    assert player.policy is not None
    module = types.ModuleType("policy")
    exec(compile(player.policy.source, player.policy.path, "exec"), vars(module))
    return [value for value in vars(module).values() if isinstance(value, type) and hasattr(value, "act")][-1]()


def _episode(env: Any, seed: int, act: Callable[[], Any]) -> tuple[int, bool]:
    """Play an episode; return its length in steps, and whether it is won."""
    env.reset(seed=seed)
    steps = 0
    while True:
        _, _, terminated, truncated, info = env.step(act())
        steps += 1
        if terminated or truncated:
            return steps, info["is_success"]


if __name__ == "__main__":
    sys.exit(main())
