"""``python -m benchmarks.tetris_speed``: steps per second of Tetris environments with frames of 84x84x3.

It measures variants of the family `tetris` as single environments, and many of them in the vectorized simulator, with
copied and with shared observations. Peers are tetris-gymnasium and the Tetris of ale-py, resized to 84x84 by a wrapper
of Gymnasium. All run in this process with random actions; rates are per second of processor time. They alternate in
short rounds, and a ratio is the median over ratios within a round, so that other load affects all alike. For single
environments, the rate is the median over variants. The first round compiles and fills caches, and is discarded.

Exit status 1 unless single environments are 4 times and the simulator with copies 30 times as fast as tetris-gymnasium.
A peer that is not installed is skipped with a message; `pip install 'envcraft-rl[peers]'` installs both.
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

from envcraft.environments.loading import open_trusted
from envcraft.environments.vector import NamedVectorEnv

SIZE = 84
PEER = "tetris-gymnasium, resized"
SINGLE, BATCH, SHARED = "single environments", "simulator", "simulator, copy=False"
#: The least ratio to the peer.
LIMITS = {SINGLE: 4.0, BATCH: 30.0}
#: Plays about this many steps, and returns the exact number.
Stepper = Callable[[int], int]


def single(env: Any) -> Stepper:
    """Step one environment in a plain loop."""
    env.reset(seed=0)
    env.action_space.seed(0)
    drawn = [env.action_space.sample() for _ in range(1000)]

    def play(steps: int) -> int:
        for step in range(steps):
            if any(env.step(drawn[step % len(drawn)])[2:4]):
                env.reset()
        return steps

    return play


def singles(generated: Sequence[Any]) -> list[Stepper]:
    """Each generated source as one environment."""
    steppers = []
    for one in generated:
        source = one.source.encode()
        digest = hashlib.sha256(source).hexdigest()
        steppers.append(single(open_trusted(one.name, f"{one.name}.py", source, digest, None, {}, {})))
    return steppers


def batch(generated: Sequence[Any], copy: bool) -> Stepper:
    """All generated sources in one simulator."""
    simulator = TetrisFamily().simulate(generated, AutoresetMode.NEXT_STEP, copy)
    vector = NamedVectorEnv(simulator, [one.name for one in generated])
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


def peers() -> dict[str, Stepper]:
    """The installed peers. Missing ones are reported."""
    found = {}
    for name, make in ((PEER, tetris_gymnasium), ("ale-py's Tetris, resized", atari)):
        try:
            found[name] = single(make())
        except (ImportError, gymnasium.error.Error) as error:
            print(f"without {name}: {error}; pip install 'envcraft-rl[peers]'", file=sys.stderr)
    return found


def rate(stepper: Stepper, steps: int) -> float:
    """Steps per second of processor time, summed over the threads of this process."""
    started = time.process_time()
    played = stepper(steps)
    return played / (time.process_time() - started)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tetris_speed", description=__doc__)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--steps", type=int, default=1500, help="steps per round of each peer")
    parser.add_argument("--files", type=int, default=40, help="number of single environments")
    parser.add_argument("--envs", type=int, default=256, help="number of environments in the simulator")
    options = parser.parse_args(arguments)
    generated = list(TetrisFamily().generate(max(options.files, options.envs), 0))
    others, own = peers(), singles(generated[: options.files])
    batches = {BATCH: batch(generated[: options.envs], True), SHARED: batch(generated[: options.envs], False)}
    rates: dict[str, list[float]] = {name: [] for name in (SINGLE, *batches, *others)}
    for number in range(options.rounds + 1):
        found = {name: rate(stepper, options.steps) for name, stepper in others.items()}
        each = [rate(stepper, options.steps // 5) for stepper in own]
        found[SINGLE] = statistics.median(each)
        found |= {name: rate(stepper, 40 * options.steps) for name, stepper in batches.items()}
        if number:
            for name, value in found.items():
                rates[name].append(value)
    console = Console(width=120)
    console.print(
        table(rates, f"{options.files} single environments, {options.envs} in the simulator, {options.rounds} rounds")
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
    """The broken limits; none without the peer."""
    if PEER not in rates:
        return []
    return [
        f"{name}: {ratio(rates, name):.1f} times {PEER}, at least {limit:g} required"
        for name, limit in LIMITS.items()
        if ratio(rates, name) < limit
    ]


if __name__ == "__main__":
    raise SystemExit(main())
