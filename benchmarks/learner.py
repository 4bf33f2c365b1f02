"""``python -m benchmarks.learner``: the speed of updates and of training beside a plain update and stable-baselines3.

Updates: the reference network on batches of 32, by the learner and by a plain version of the same update (32-bit
floats, torch's default memory layout, convolutions, Adam and memory allocation). The learner must be 1.8 times as fast.

End to end: environment steps a second of training with one update every four steps, on one Tetris variant, with the
network ``small``. stable-baselines3's DQN, whose network has about as many parameters, trains on the same environment
with the same number of environments and with one. EnvCraft must be twice as fast as the faster of these.

``--device cuda`` instead compares updates on a GPU with those on the CPU, by wall-clock time: with the defaults of
``envcraft train``, the reference network, and the settings of ``envcraft study --scale gpu``, whose frames are on the
device already. They share one process, and there is no limit.

Each measurement has its own process. They take turns; a rate is the median of the rounds, per CPU second, so that other
work on the machine has little effect. One thread, unless OMP_NUM_THREADS sets another number. The exit status is 1 if a
limit is broken.
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
import msgspec
import numpy as np
import torch
from envcraft_dqn import learner as own
from envcraft_dqn.callbacks import Callback
from envcraft_dqn.env_spec import EnvSpec
from envcraft_dqn.learner import Learner
from envcraft_dqn.network import Network
from envcraft_dqn.replay import Batch
from envcraft_dqn.settings import Settings
from envcraft_dqn.study.presets import PRESETS
from envcraft_dqn.trainer import train
from envcraft_tetris.family import TetrisFamily
from rich.console import Console
from rich.table import Table

import envcraft

PAD = EnvSpec((84, 84, 3), (5, 2, 2))
UPDATES, END_TO_END = 1.8, 2.0


class Plain(Learner):
    """The same update without the optimisations."""

    def __init__(self, settings: Settings, spec: EnvSpec) -> None:
        changed: dict[str, Any] = vars(own)
        changed["keep_memory"] = lambda: None
        super().__init__(settings, spec)
        for one in (self.network, self.target):
            whole: Any = one
            whole.to(memory_format=torch.contiguous_format)
        self.optimiser = torch.optim.Adam(self.network.parameters(), settings.learning_rate, eps=1.5e-4)
        self.bf16 = False


#: The updates that ``--device`` compares.
COMPARED = {
    "defaults": Settings(),
    "reference network": Settings(size="reference"),
    "study --scale gpu": PRESETS["gpu"].settings,
}


def batch(count: int = 32) -> Batch:
    rng = np.random.default_rng(0)
    frames = rng.integers(0, 256, (2 * count, *PAD.shape), np.uint8)
    ones = np.ones(count, np.float32)
    actions, labels = rng.integers(0, 20, count), np.zeros(count, np.int64)
    parts = ones, ones * 0.97, ones, labels, ones, np.zeros((count, 0), np.float32)
    return Batch(np.arange(count), frames[:count], frames[count:], actions, *parts)


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


def prepared(settings: Settings) -> Callable[[], Any]:
    """A function that makes one update, with as many frames in a batch as it reads."""
    made, given = Learner(settings, PAD), batch(settings.batch)
    if settings.imitates:
        given.next_frames = given.next_frames[:0]
    if settings.replay == "device":
        given.frames, given.next_frames = (
            torch.from_numpy(frames).to(made.device) for frames in (given.frames, given.next_frames)
        )
    for _ in range(3):
        made.update(given)
    return partial(made.update, given)


def rate(update: Callable[[], Any], seconds: float) -> float:
    """Updates a second of wall-clock time."""
    done, started = 0, time.perf_counter()
    while (passed := time.perf_counter() - started) < seconds:
        update()
        done += 1
    return done / passed


def compare_devices(console: Console, device: str, seconds: float, rounds: int) -> None:
    """Print the updates a second on a device, there with ``--compiled``, and on the CPU."""
    named = torch.cuda.get_device_name(device) if device.startswith("cuda") else device
    cpu = Learner(Settings(device="cpu"), PAD)
    table = Table(title=f"updates/s, {named} and a CPU ({cpu.precision}, threads: {torch.get_num_threads()})")
    for column in ("", "parameters", "batch", device, "compiled", "CPU", "ratio"):
        table.add_column(column, justify="right" if column else "left")
    for name, settings in COMPARED.items():
        placed: tuple[dict[str, Any], ...] = (
            {"device": device},
            {"device": device, "compiled": True},
            {"device": "cpu"},
        )
        ways = [prepared(msgspec.structs.replace(settings, **where)) for where in placed]
        found = zip(*([rate(way, seconds) for way in ways] for _ in range(rounds)), strict=True)
        rates = [statistics.median(column) for column in found]
        count = Network(PAD.shape, PAD.choices, settings.size).parameter_count
        cells = (f"{count:,}", str(settings.batch), *(f"{one:,.1f}" for one in rates), f"{rates[0] / rates[2]:,.1f}")
        table.add_row(name, *cells)
    console.print(table)


class Joint(gymnasium.ActionWrapper[Any, Any, Any]):
    """A joint action as one number: stable-baselines3's DQN supports only Discrete actions."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Discrete(20)

    def action(self, action: Any) -> Any:
        return np.array(np.unravel_index(int(action), PAD.choices))


def ours(path: Path, num_envs: int, steps: int) -> float:
    """Environment steps a second while training for this many steps."""
    kept: dict[str, Any] = {"capacity": 50_000, "starts": 200, "epsilon_share": 1e-9, "device": "cpu"}
    settings = Settings(steps=steps, num_envs=num_envs, segment=steps // num_envs, **kept)

    class Clock(Callback):
        """Counts from the first update to the last, without the setup before and the checkpoint after."""

        begun, ended, waiting, counted = 0.0, 0.0, 0, 0

        def on_update(self, loss: float) -> None:
            self.ended = time.process_time()
            self.begun = self.begun or self.ended
            self.counted, self.waiting = self.counted + self.waiting, 0

        def on_step(self, indices: Any, rewards: Any, dones: Any) -> None:
            self.waiting += len(indices) if self.begun else 0

    def open_vector(names: Sequence[str]) -> Any:
        return envcraft.make_vec([path] * len(names), trust=True, workers=0)

    clock = Clock()
    with tempfile.TemporaryDirectory() as folder:
        train(settings, ["variant"], open_vector, Path(folder), callback=clock, every=1e9)
        return clock.counted / (clock.ended - clock.begun)


def theirs(path: Path, num_envs: int, steps: int) -> float:
    """The same for stable-baselines3's DQN."""
    from stable_baselines3 import DQN
    from stable_baselines3.common.vec_env import DummyVecEnv

    vector = DummyVecEnv([lambda: Joint(envcraft.make(path, trust=True))] * num_envs)
    model = DQN(
        "CnnPolicy",
        vector,
        batch_size=32,
        buffer_size=5_000,
        learning_starts=200,
        train_freq=max(4 // num_envs, 1),
        gradient_steps=max(num_envs // 4, 1),
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
    """The median result of each function, each called in its own process."""
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
    """Print the tables; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learner", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=5.0, help="seconds of updates per round")
    parser.add_argument("--steps", type=int, default=1_000, help="steps of training per round")
    parser.add_argument("--lanes", type=int, default=8)
    parser.add_argument("--device", help="compare the updates on this device with those on the CPU, and no others")
    options = parser.parse_args(arguments)
    console = Console(width=120, file=sys.stdout)
    if options.device is not None:
        compare_devices(console, options.device, options.seconds, options.rounds)
        return 0
    kinds = {"EnvCraft": False, "plain": True}
    found = medians({name: partial(updates, plain, options.seconds) for name, plain in kinds.items()}, options.rounds)
    show(console, described(), "updates/s", found)
    broken = []
    if (ratio := found["EnvCraft"] / found["plain"]) < UPDATES:
        broken.append(f"updates are {ratio:.2f} times as fast as plain ones; at least {UPDATES}")
    console.print(f"{ratio:.2f} times as fast")
    with tempfile.TemporaryDirectory() as folder:
        [variant] = TetrisFamily().generate(1, 0)
        path = Path(folder, f"{variant.name}.py")
        path.write_text(variant.source)
        ways = {
            f"EnvCraft, {options.lanes} environments": partial(ours, path, options.lanes, options.steps),
            f"stable-baselines3, {options.lanes} environments": partial(theirs, path, options.lanes, options.steps),
            "stable-baselines3, one environment": partial(theirs, path, 1, options.steps),
        }
        found = medians(ways, options.rounds)
    show(console, "training with an update every four steps", "environment steps/s", found)
    mine, *rest = found.values()
    if (ratio := mine / max(rest)) < END_TO_END:
        broken.append(f"training is {ratio:.2f} times as fast as stable-baselines3; at least {END_TO_END}")
    console.print(f"{ratio:.2f} times as fast")
    for words in broken:
        console.print(f"limit broken: {words}")
    return int(bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
