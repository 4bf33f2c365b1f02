"""``python -m benchmarks.tetris_speed``: games of falling pieces with frames of 84x84x3, by whom they are played.

Variants of the family `tetris`, each as its file in this process, and many of them in the fast lane, with copies of the
frames and in place; beside them tetris-gymnasium and the Tetris of ale-py, whose frames are resized to 84x84 by
Gymnasium's own wrapper. All play random actions and begin again when a game is over, all in this process, and a second
is one of its processor time. They take turns in short rounds, and a ratio is the median of those within one round, so
that other work on the machine hits all of them; of the files it is the median over the variants. The first round
compiles and fills caches, and does not count.

The files are held to be 4 times as fast as tetris-gymnasium, and the fast lane, with copies, 30 times: exit status 1
where they are not. A peer that is not installed is left out, and says so; `pip install 'envcraft-rl[peers]'` has both.
"""

from __future__ import annotations

import argparse
import hashlib
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np
from envcraft_tetris.family import TetrisFamily
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import ResizeObservation
from rich.console import Console
from rich.table import Table

from envcraft.using.loading import open_trusted
from envcraft.using.vector import VectorEnv

SIZE = 84
PEER = "tetris-gymnasium, resized"
FILES, LANE, IN_PLACE = "files of the family", "fast lane", "fast lane, frames in place"
#: At least so many times as fast as the peer.
LIMITS = {FILES: 4.0, LANE: 30.0}
#: Plays about so many steps, and gives how many there were.
Player = Callable[[int], int]


def single(env: Any) -> Player:
    """One environment in a plain loop."""
    env.reset(seed=0)
    env.action_space.seed(0)
    drawn = [env.action_space.sample() for _ in range(1000)]

    def play(steps: int) -> int:
        for step in range(steps):
            if any(env.step(drawn[step % len(drawn)])[2:4]):
                env.reset()
        return steps

    return play


def files(generated: Sequence[Any]) -> list[Player]:
    """Each file by itself."""
    players = []
    for one in generated:
        source = one.source.encode()
        digest = hashlib.sha256(source).hexdigest()
        players.append(single(open_trusted(one.name, f"{one.name}.py", source, digest, None, {}, {})))
    return players


def lane(generated: Sequence[Any], copy: bool) -> Player:
    """All side by side."""
    simulator = TetrisFamily().simulate(generated)
    vector = VectorEnv([one.name for one in generated], simulator, AutoresetMode.NEXT_STEP, copy)
    vector.reset(seed=0)
    drawn = np.random.default_rng(0).integers(0, [5, 2, 2], (100, len(generated), 3))

    def play(steps: int) -> int:
        count = max(1, steps // len(generated))
        for step in range(count):
            vector.step(drawn[step % len(drawn)])
        return count * len(generated)

    return play


def tetris_gymnasium() -> Any:
    """Raises ImportError."""
    from tetris_gymnasium.envs.tetris import Tetris
    from tetris_gymnasium.wrappers.observation import RgbObservation

    return ResizeObservation(RgbObservation(Tetris(render_mode="rgb_array")), (SIZE, SIZE))


def atari() -> Any:
    """Raises ImportError."""
    import ale_py

    gymnasium.register_envs(ale_py)
    env = gymnasium.make("ALE/Tetris-v5", obs_type="rgb", frameskip=1, repeat_action_probability=0.0)
    return ResizeObservation(env, (SIZE, SIZE))


def peers() -> dict[str, Player]:
    """Those that are installed; what is missing is told."""
    found = {}
    for name, make in ((PEER, tetris_gymnasium), ("ale-py's Tetris, resized", atari)):
        try:
            found[name] = single(make())
        except (ImportError, gymnasium.error.Error) as error:
            print(f"without {name}: {error}; pip install 'envcraft-rl[peers]'", file=sys.stderr)
    return found


def rate(player: Player, steps: int) -> float:
    """Steps a second of processor time, all threads of this process together."""
    started = time.process_time()
    played = player(steps)
    return played / (time.process_time() - started)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; give 1 where a limit does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tetris_speed", description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--steps", type=int, default=1500, help="of each peer in a round, and of all files")
    parser.add_argument("--files", type=int, default=40, help="how many variants are played as files")
    parser.add_argument("--envs", type=int, default=256, help="how many variants are in the fast lane")
    options = parser.parse_args(arguments)
    generated = list(TetrisFamily().generate(max(options.files, options.envs), 0))
    others, own = peers(), files(generated[: options.files])
    lanes = {LANE: lane(generated[: options.envs], True), IN_PLACE: lane(generated[: options.envs], False)}
    rates: dict[str, list[float]] = {name: [] for name in (FILES, *lanes, *others)}
    for number in range(options.rounds + 1):
        found = {name: rate(player, options.steps) for name, player in others.items()}
        each = [rate(player, options.steps // 5) for player in own]
        found[FILES] = statistics.median(each)
        found |= {name: rate(player, 40 * options.steps) for name, player in lanes.items()}
        if number:
            for name, value in found.items():
                rates[name].append(value)
    console = Console(width=120)
    console.print(
        table(rates, f"{options.files} files, {options.envs} games in the fast lane, {options.rounds} rounds")
    )
    slow = broken(rates)
    for line in slow:
        console.print(f"limit broken: {line}")
    return int(bool(slow))


def ratio(rates: dict[str, list[float]], name: str) -> float:
    return statistics.median(own / peer for own, peer in zip(rates[name], rates[PEER], strict=True))


def table(rates: dict[str, list[float]], title: str) -> Table:
    made = Table(title=f"frames of {SIZE}x{SIZE}x3: {title}")
    for column in ("", "steps/s, median", "least", "most", f"times {PEER}", "at least"):
        made.add_column(column, justify="right" if column else "left")
    for name, found in rates.items():
        beside = f"{ratio(rates, name):.1f}" if PEER in rates else ""
        limit = f"{LIMITS[name]:g}" if name in LIMITS else ""
        figures = (f"{value:,.0f}" for value in (statistics.median(found), min(found), max(found)))
        made.add_row(name, *figures, beside, limit)
    return made


def broken(rates: dict[str, list[float]]) -> list[str]:
    """The limits that do not hold; without the peer none can be told."""
    if PEER not in rates:
        return []
    return [
        f"{name}: {ratio(rates, name):.1f} times {PEER}, and at least {limit:g} are wanted"
        for name, limit in LIMITS.items()
        if ratio(rates, name) < limit
    ]


if __name__ == "__main__":
    raise SystemExit(main())
