"""``python -m benchmarks.composer``: how the games of the family `composer` play, and how much they differ.

Of each game it measures the wins of the player, of random play and of doing nothing, and the steps per second of
processor time with frames, resets included. The games are generated sources and run in this process.

The diversity of behaviour is the Vendi score of fingerprints, as a share of the number of games, beside the Tetris
family and the games of the generation demo. Each share is of the same number of games, which are played in the sandbox.
For the difficulty, the same games are generated at some levels. Of ``--sources`` games it counts the lines of the
shortest and the longest, the smallest and the largest number for a goal, and those that are duplicates by text or
structure; each is a part of what ``envcraft corpus dedup`` compares.

The exit status is 1 if a limit is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
import types
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from statistics import median
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from envcraft_composer.family import ComposerFamily
from envcraft_composer.policy import Composed
from envcraft_llm.recorded import ARCHIVE, load
from envcraft_sandbox.process import ProcessDriver
from envcraft_tetris.family import TetrisFamily
from rich.console import Console
from rich.table import Table

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.target import Target
from envcraft.similarity import behavioural, diversity, near, structural
from envcraft.similarity.groups import Groups

#: The share of wins that the player reaches, and that random play does not exceed; on these shares of the games.
PLAYER_WINS, PLAYER_GAMES = 0.9, 0.95
RANDOM_WINS, RANDOM_GAMES = 0.2, 0.9
STEPS_PER_SECOND = 5_000
LEVELS = (0.0, 0.4, 0.8, 1.0)
LEAST_LINES, MOST_LINES = 80, 250


class Played(NamedTuple):
    """The share of wins and the mean steps of some episodes, and the steps per second of processor time."""

    wins: float
    steps: float
    speed: float


class Measured(NamedTuple):
    """The results of one game."""

    name: str
    player: Played
    random: Played
    idle: Played


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.composer", description=__doc__)
    parser.add_argument("--games", type=int, default=20)
    parser.add_argument("--episodes", type=int, default=10, help="episodes of each player in each game")
    parser.add_argument("--levels", type=int, default=13, help="games that are played at each level of difficulty")
    parser.add_argument("--sources", type=int, default=1000, help="games whose sources are compared")
    parser.add_argument("--verbose", action="store_true", help="print a line for each game")
    options = parser.parse_args(arguments)
    missed = 0
    table = Table(title=f"composer, {options.games} games, {options.episodes} episodes of each player")
    for column in ("", "measured", "limit"):
        table.add_column(column)

    def row(name: str, measured: str, limit: str, kept: bool) -> None:
        nonlocal missed
        missed += not kept
        table.add_row(name, measured if kept else f"{measured} (missed)", limit)

    games = []
    for generated in ComposerFamily().generate(options.games, 0):
        games.append(measure(generated.name, generated.source, options.episodes))
        if options.verbose:
            one = games[-1]
            print(
                f"{one.name}: player {one.player.wins:.0%} in {one.player.steps:.0f} steps, random "
                f"{one.random.wins:.0%}, nothing {one.idle.wins:.0%}, {one.random.speed:,.0f} steps/s",
                file=sys.stderr,
            )
    count = len(games)
    won = sum(game.player.wins >= PLAYER_WINS for game in games)
    lucky = sum(game.random.wins <= RANDOM_WINS for game in games)
    idle = sum(game.idle.wins > 0 for game in games)
    speed = median(game.random.speed for game in games)
    often, rarely = won / count, lucky / count
    row(f"player wins {PLAYER_WINS:.0%}", f"{often:.1%} of games", f">= {PLAYER_GAMES:.0%}", often >= PLAYER_GAMES)
    row(f"random wins <= {RANDOM_WINS:.0%}", f"{rarely:.1%} of games", f">= {RANDOM_GAMES:.0%}", rarely >= RANDOM_GAMES)
    row("doing nothing wins", f"{idle} games", "0", idle == 0)
    row("steps per second, median", f"{speed:,.0f}", f">= {STEPS_PER_SECOND:,}", speed >= STEPS_PER_SECOND)
    sources = list(ComposerFamily().generate(options.sources, 0))
    lines = [one.source.count("\n") for one in sources]
    short = min(lines) >= LEAST_LINES and max(lines) <= MOST_LINES
    row(f"lines of {options.sources:,} games", f"{min(lines)} to {max(lines)}", f"{LEAST_LINES} to {MOST_LINES}", short)
    goals = Counter(one.metadata["axes"]["goal"] for one in sources)
    row("games of a goal", ", ".join(f"{goal} {number}" for goal, number in goals.most_common()), "", True)
    alike = duplicates([one.source.encode() for one in sources])
    row("duplicates by text or structure", f"{alike} games", "0", alike == 0)
    shares = diversities(options.games)
    for name, share in shares.items():
        limit = "" if name == "composer" else "below composer"
        row(f"Vendi score by behaviour, {name}", f"{share:.1%}", limit, not limit or share < shares["composer"])
    levels = [at_level(level, options.levels, options.episodes) for level in LEVELS]
    for number, (level, (steps, wins)) in enumerate(zip(LEVELS, levels, strict=True)):
        kept = not number or (steps > levels[number - 1][0] and wins <= levels[number - 1][1])
        limit = "more steps, no more wins" if number else ""
        row(f"difficulty {level:g}: player's steps, random wins", f"{steps:.1f}, {wins:.1%}", limit, kept)
    Console(width=120, file=sys.stdout).print(table)
    return int(missed > 0)


def measure(name: str, source: str, episodes: int) -> Measured:
    """Play a game by the player, at random and without actions."""
    env = load_game(source)
    rng = np.random.default_rng(0)
    return Measured(
        name,
        play(env, range(episodes), by_player(env)),
        play(env, range(episodes), lambda: lambda: rng.integers(0, [5, 2, 2])),
        play(env, range(episodes), lambda: lambda: (0, 0, 0)),
    )


def by_player(env: Any) -> Callable[[], Callable[[], Any]]:
    """What makes the player's choices of an episode."""

    def start() -> Callable[[], Any]:
        player = Composed()
        return lambda: player.act(env)

    return start


def play(env: Any, seeds: Iterable[int], start: Callable[[], Callable[[], Any]]) -> Played:
    """Play an episode on each seed."""
    wins, lengths = [], []
    began = time.process_time()
    for seed in seeds:
        env.reset(seed=seed)
        choose, steps, over = start(), 0, False
        while not over:
            _, _, terminated, truncated, info = env.step(choose())
            steps += 1
            over = terminated or truncated
        wins.append(info["is_success"])
        lengths.append(steps)
    speed = sum(lengths) / max(time.process_time() - began, 1e-9)
    return Played(float(np.mean(wins)), float(np.mean(lengths)), speed)


def load_game(source: str) -> Any:
    """The environment of a source that this repository's own mechanics made."""
    module = types.ModuleType("composed")
    exec(compile(source, "composed.py", "exec"), vars(module))
    return next(kind for kind in vars(module).values() if isinstance(kind, type) and issubclass(kind, gym.Env))()


def duplicates(sources: Sequence[bytes]) -> int:
    """How many sources have the structure of another, or nearly its text."""
    groups = Groups(len(sources))
    first: dict[bytes | None, int] = {}
    for number, source in enumerate(sources):
        groups.join(number, first.setdefault(structural.key(source), number))
    sets = near.own([near.shingles(near.key(source) or b"") for source in sources])
    keyed = [number for number, found in enumerate(sets) if found is not None]
    texts = [found for found in sets if found is not None]
    for one, two in near.pairs(texts, near.THRESHOLD, Groups(len(texts))):
        groups.join(keyed[one], keyed[two])
    return sum(len(group) for group in groups.all() if len(group) > 1)


def diversities(count: int) -> dict[str, float]:
    """The Vendi score of each set of games by behaviour, as a share of the number of games; equal numbers of games."""
    # Some concepts are turned down before any code is written.
    attempts = [[name for name in one.files if name.startswith("attempt_")] for one in load(ARCHIVE)]
    demo = [one.files[max(names)] for one, names in zip(load(ARCHIVE), attempts, strict=True) if names]
    count = min(count, len(demo))
    sources = {
        "composer": [one.source for one in ComposerFamily().generate(count, 0)],
        "tetris": [one.source for one in TetrisFamily().generate(count, 0)],
        "generation demo": demo[:count],
    }
    shares = {}
    for name, texts in sources.items():
        series = [found for text in texts if (found := behavioural.read(_fingerprint(text.encode()))) is not None]
        shares[name] = diversity.vendi(behavioural.kernel(series)) / max(len(series), 1)
    return shares


def _fingerprint(source: bytes) -> str:
    lease = WorkerPool(ProcessDriver()).lease()
    with Subject(Target("game.py", source), ARCADE, lease, BUDGETS["quick"]) as subject:
        subject.rollout(subject.probes.sticky(0).cut(behavioural.STEPS))
        return subject.fingerprint


def at_level(level: float, count: int, episodes: int) -> tuple[float, float]:
    """The mean steps of the player's episodes and random play's share of wins at a level of difficulty."""
    steps, wins = [], []
    rng = np.random.default_rng(1)
    for generated in ComposerFamily().generate(count, 1, level):
        env = load_game(generated.source)
        steps.append(play(env, range(min(episodes, 3)), by_player(env)).steps)
        wins.append(play(env, range(episodes), lambda: lambda: rng.integers(0, [5, 2, 2])).wins)
    return float(np.mean(steps)), float(np.mean(wins))


if __name__ == "__main__":
    raise SystemExit(main())
