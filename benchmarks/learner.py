"""``python -m benchmarks.learner``: updates of the large network, and training as a whole beside stable-baselines3's
DQN.

Updates: the reference network on batches of 32, as the learner makes them, and as the same update is written plainly:
32-bit floats, torch's default layout, its own convolutions, its default Adam and the C library's way with memory. The
learner is held to be 1.8 times as fast.

End to end: environment steps a second of training with one update every four, on one Tetris variant, the network
``small``, which has about as many parameters as that of stable-baselines3's DQN, which trains on the same environment
with as many side by side, and with one. EnvCraft is held to be twice as fast as the faster of these.

Each has a process of its own; they take turns in rounds, a rate is the median of the rounds, and seconds are the
processor's, so that what else runs counts little. One thread, unless OMP_NUM_THREADS says otherwise. Exit status 1
where a limit does not hold.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch
from envcraft_dqn import learner as own
from envcraft_dqn.learner import Learner
from envcraft_dqn.replay import Batch
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import Surface
from envcraft_dqn.telling import Teller
from envcraft_tetris.family import TetrisFamily
from rich.console import Console
from rich.table import Table

import envcraft

PAD = Surface((84, 84, 3), (5, 2, 2))
UPDATES, END_TO_END = 1.8, 2.0


class Plain(Learner):
    """The same update without what is there for speed."""

    def __init__(self, settings: Settings, surface: Surface) -> None:
        changed: dict[str, Any] = vars(own)
        changed["keep_memory"] = lambda: None
        super().__init__(settings, surface)
        for one in (self.network, self.target):
            whole: Any = one
            whole.to(memory_format=torch.contiguous_format)
        self.optimiser = torch.optim.Adam(self.network.parameters(), settings.learning_rate, eps=1.5e-4)
        self.bf16 = False


def batch(count: int = 32) -> Batch:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2 * count, *PAD.shape), np.uint8)
    ones = np.ones(count, np.float32)
    return Batch(np.arange(count), frames[:count], frames[count:], rng.integers(0, 20, count), ones, ones * 0.97, ones)


@cache
def learner(plain: bool) -> Learner:
    return (Plain if plain else Learner)(Settings(size="reference", device="cpu"), PAD)


def described() -> str:
    made = learner(False)
    return f"{made.network.parameter_count:,} parameters, batch 32, EnvCraft in {'bf16' if made.bf16 else 'fp32'}"


def updates(plain: bool, seconds: float) -> float:
    """Updates a second."""
    given, made = batch(), learner(plain)
    made.update(given)
    done, started = 0, time.process_time()
    while (passed := time.process_time() - started) < seconds:
        made.update(given)
        done += 1
    return done / passed


class Joint(gymnasium.ActionWrapper[Any, Any, Any]):
    """One number for a joint action, which is all that stable-baselines3's DQN has."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Discrete(20)

    def action(self, action: Any) -> Any:
        return np.array(np.unravel_index(int(action), PAD.choices))


def ours(path: Path, lanes: int, steps: int) -> float:
    """Environment steps a second of so many steps of training."""
    kept: dict[str, Any] = {"capacity": 50_000, "starts": 200, "epsilon_share": 1e-9, "device": "cpu"}
    settings = Settings(steps=steps, lanes=lanes, leg=steps // lanes, **kept)

    class Clock(Teller):
        """Counts from the first update to the last, since a run is set up before and saved after them."""

        begun, ended, waiting, counted = 0.0, 0.0, 0, 0

        def updated(self, loss: float) -> None:
            self.ended = time.process_time()
            self.begun = self.begun or self.ended
            self.counted, self.waiting = self.counted + self.waiting, 0

        def stepped(self, lanes: Any, rewards: Any, over: Any) -> None:
            self.waiting += len(lanes) if self.begun else 0

    def open_vector(names: Sequence[str]) -> Any:
        return envcraft.make_vec([path] * len(names), trust=True, workers=0)

    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        own.train(settings, ["variant"], open_vector, Path(folder), teller=clock, every=1e9)
        return clock.counted / (clock.ended - clock.begun)


def theirs(path: Path, lanes: int, steps: int) -> float:
    """The same of stable-baselines3's DQN."""
    from stable_baselines3 import DQN
    from stable_baselines3.common.vec_env import DummyVecEnv

    vector = DummyVecEnv([lambda: Joint(envcraft.make(path, trust=True))] * lanes)
    model = DQN(
        "CnnPolicy",
        vector,
        batch_size=32,
        buffer_size=5_000,
        learning_starts=200,
        train_freq=max(4 // lanes, 1),
        gradient_steps=max(lanes // 4, 1),
        learning_rate=3e-4,
        exploration_fraction=1e-9,
        exploration_final_eps=0.1,
        device="cpu",
    )
    model.learn(200)
    started = time.process_time()
    model.learn(steps - 200, reset_num_timesteps=False)
    vector.close()
    return (steps - 200) / (time.process_time() - started)


def medians(ways: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """What each way gives, called in a process of its own."""
    found: dict[str, list[float]] = {name: [] for name in ways}
    with contextlib.ExitStack() as stack:
        context = multiprocessing.get_context("spawn")
        pools = {name: stack.enter_context(ProcessPoolExecutor(1, context)) for name in ways}
        for number in range(rounds):
            for name in list(ways)[:: -1 if number % 2 else 1]:
                found[name].append(pools[name].submit(ways[name]).result())
    return {name: statistics.median(values) for name, values in found.items()}


def show(console: Console, title: str, column: str, found: dict[str, float]) -> None:
    table = Table(title=title)
    table.add_column("")
    table.add_column(column, justify="right")
    for name, rate in found.items():
        table.add_row(name, f"{rate:,.2f}")
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; give 1 where a limit does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learner", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="of updates in a round")
    parser.add_argument("--steps", type=int, default=1_000, help="of training in a round")
    parser.add_argument("--lanes", type=int, default=8)
    options = parser.parse_args(arguments)
    console = Console(width=120, file=sys.stdout)
    kinds = {"EnvCraft": False, "plain": True}
    found = medians({name: partial(updates, plain, options.seconds) for name, plain in kinds.items()}, options.rounds)
    show(console, described(), "updates/s", found)
    broken = []
    if (ratio := found["EnvCraft"] / found["plain"]) < UPDATES:
        broken.append(f"updates are {ratio:.2f} times as fast as written plainly, at least {UPDATES}")
    console.print(f"{ratio:.2f} times as fast")
    with tempfile.TemporaryDirectory() as folder:
        [variant] = TetrisFamily().generate(1, 0)
        path = Path(folder, f"{variant.name}.py")
        path.write_text(variant.source)
        ways = {
            f"EnvCraft, {options.lanes} side by side": partial(ours, path, options.lanes, options.steps),
            f"stable-baselines3, {options.lanes} side by side": partial(theirs, path, options.lanes, options.steps),
            "stable-baselines3, one": partial(theirs, path, 1, options.steps),
        }
        found = medians(ways, options.rounds)
    show(console, "training with an update every four steps", "environment steps/s", found)
    mine, *rest = found.values()
    if (ratio := mine / max(rest)) < END_TO_END:
        broken.append(f"training is {ratio:.2f} times as fast as stable-baselines3's, at least {END_TO_END}")
    console.print(f"{ratio:.2f} times as fast")
    for words in broken:
        console.print(f"limit broken: {words}")
    return int(bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
