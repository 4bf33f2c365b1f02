"""``python -m benchmarks.replay``: the prioritised replay buffer beside those of other libraries.

Priorities: a buffer with a million priorities samples batches of 32 and of 256 and updates their priorities. Each
library's class is called as its users call it, with the smallest possible transitions, so that the sampler dominates.
Images: batches of 32 transitions of 84x84x3 frames of Tetris variants, with observation and next observation, as arrays
on the host, from buffers of ``--frames`` transitions; and the bytes per stored transition.

The libraries take turns in short rounds; a rate is the median of the rounds, per CPU second, so that other work on the
machine has little effect. EnvCraft must be at least as fast as the fastest peer at both batch sizes, and its raw
frames at least as fast as stable-baselines3, which stores raw frames too. A packed transition must take at most 1,000
bytes, and an update of the network ``small`` on packed frames at most 5% more time than on raw frames. Otherwise the
exit status is 1. The output names the peers that are not installed (see ``benchmarks/trainer_requirements.txt``).
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from envcraft_dqn.frames import CompressedFrames, FrameStore, RawFrames
from envcraft_dqn.replay import Replay
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

OURS = "EnvCraft"
BYTES = 1_000
#: The limit on the relative time of an update with packed frames.
UPDATE = 1.05
#: One call samples a batch and, for priorities, updates them.
Call = Callable[[], object]


def our_priorities(count: int, batch: int) -> Call:
    rng = np.random.default_rng(0)
    replay = Replay(RawFrames(count, (1,)), count, 1, 0.99)
    replay.restore({"at": 0, "added": count + 1, "kept": 0, "highest": 1.0}, {"priorities": rng.random(count)})

    def call() -> None:
        slots, _ = replay.draw(batch, 0.4, rng)
        replay.update(slots, rng.random(batch, np.float32))

    return call


def tianshou_priorities(count: int, batch: int) -> Call:
    from tianshou.data import Batch, PrioritizedReplayBuffer

    buffer: Any = PrioritizedReplayBuffer(count, alpha=0.6, beta=0.4)
    zeros = np.zeros(count, np.float32)
    flags = np.zeros(count, bool)
    buffer.set_batch(
        Batch(obs=zeros, act=zeros, rew=zeros, terminated=flags, truncated=flags, done=flags, obs_next=zeros, info={})
    )
    buffer._size = count
    rng = np.random.default_rng(0)
    buffer.weight[np.arange(count)] = rng.random(count)

    def call() -> None:
        indices = buffer.sample_indices(batch)
        buffer.get_weight(indices)
        buffer.update_weight(indices, rng.random(batch))

    return call


def cpprb_priorities(count: int, batch: int) -> Call:
    from cpprb import PrioritizedReplayBuffer

    buffer = PrioritizedReplayBuffer(count, {"rew": {}}, alpha=0.6)
    rng = np.random.default_rng(0)
    buffer.add(rew=np.zeros(count), priorities=rng.random(count))

    def call() -> None:
        drawn = buffer.sample(batch, 0.4)
        buffer.update_priorities(drawn["indexes"], rng.random(batch))

    return call


def torchrl_priorities(count: int, batch: int) -> Call:
    import torch
    from torchrl.data import LazyTensorStorage
    from torchrl.data.replay_buffers.samplers import PrioritizedSampler

    sampler = PrioritizedSampler(count, alpha=0.6, beta=0.4)
    storage = LazyTensorStorage(count)
    storage.set(range(count), torch.zeros(count))
    sampler.extend(torch.arange(count))
    generator = torch.Generator().manual_seed(0)
    sampler.update_priority(torch.arange(count), torch.rand(count, generator=generator))

    def call() -> None:
        indices, _ = sampler.sample(storage, batch)
        sampler.update_priority(torch.as_tensor(indices), torch.rand(batch, generator=generator))

    return call


def tetris_frames(count: int) -> NDArray[np.uint8]:
    """Frames of random play in twenty variants of the family, in order, [count, 84, 84, 3]."""
    import tempfile
    from pathlib import Path

    from envcraft_tetris.family import TetrisFamily

    import envcraft

    variants = 20
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for one in TetrisFamily().generate(variants, 0):
            path = Path(folder, f"{one.name}.py")
            path.write_text(one.source)
            env = envcraft.make(path, trust=True)
            env.action_space.seed(0)
            seen, _ = env.reset(seed=0)
            for _ in range(count // variants):
                found.append(seen)
                seen, _, terminated, truncated, _ = env.step(env.action_space.sample())
                if terminated or truncated:
                    seen, _ = env.reset()
    return np.stack(found)


def our_images(frames: NDArray[np.uint8], packed: bool) -> tuple[Call, float]:
    replay = filled(frames, packed)
    rng = np.random.default_rng(0)
    return lambda: replay.sample(32, 0.4, rng), replay.nbytes / replay.size


def filled(frames: NDArray[np.uint8], packed: bool) -> Replay:
    """A replay with a transition for each frame."""
    size = len(frames) + 1
    store: FrameStore = CompressedFrames(size, frames.shape[1:]) if packed else RawFrames(size, frames.shape[1:])
    replay = Replay(store, size, 3, 0.99)
    replay.reset(1)
    index, no = np.zeros(1, np.int64), np.zeros(1, np.bool_)
    for at in range(len(frames)):
        replay.add(index, frames[at : at + 1], index, np.zeros(1), no, no, frames[at : at + 1])
    replay.truncate(index, frames[-1:])
    return replay


def update_ratio(frames: NDArray[np.uint8], rounds: int) -> float:
    """The median ratio of the time of an update on packed frames to one on raw frames, on one thread."""
    import torch
    from envcraft_dqn.env_spec import EnvSpec
    from envcraft_dqn.learner import Learner
    from envcraft_dqn.settings import Settings

    torch.set_num_threads(1)
    learner = Learner(Settings(device="cpu"), EnvSpec(frames.shape[1:], (5, 2, 2)))
    rng = np.random.default_rng(0)

    def seconds(replay: Replay) -> float:
        started = time.process_time()
        for _ in range(8):
            batch = replay.sample(32, 0.4, rng)
            replay.update(batch.slots, learner.update(batch)[0])
        return time.process_time() - started

    replays = [filled(frames, packed) for packed in (True, False)]
    pairs = []
    for number in range(rounds + 1):
        times = [seconds(replay) for replay in replays[:: -1 if number % 2 else 1]]
        packed, raw = times[:: -1 if number % 2 else 1]
        pairs.append(packed / raw)
    return statistics.median(pairs[1:])


def sb3_images(frames: NDArray[np.uint8]) -> tuple[Call, float]:
    from gymnasium.spaces import Box, Discrete
    from stable_baselines3.common.buffers import ReplayBuffer

    count, shape = len(frames), frames.shape[1:]
    # Channels first, as its networks take them.
    buffer = ReplayBuffer(count, Box(0, 255, (shape[2], *shape[:2]), np.uint8), Discrete(20), "cpu")
    for at in range(count):
        frame = frames[at].transpose(2, 0, 1)
        buffer.add(frame[None], frame[None], np.zeros((1, 1)), np.zeros(1), np.zeros(1), [{}])
    parts = (buffer.observations, buffer.next_observations, buffer.actions, buffer.rewards, buffer.dones)
    return lambda: buffer.sample(32), sum(part.nbytes for part in (*parts, buffer.timeouts)) / count


def cpprb_images(frames: NDArray[np.uint8]) -> tuple[Call, float]:
    from cpprb import PrioritizedReplayBuffer

    count, shape = len(frames), frames.shape[1:]
    columns = {"obs": {"shape": shape, "dtype": np.uint8}, "act": {"dtype": np.int16}, "rew": {}, "done": {}}
    buffer = PrioritizedReplayBuffer(count, columns, next_of="obs")
    for at in range(count):
        buffer.add(obs=frames[at], act=0, rew=0.0, done=0.0, next_obs=frames[min(at + 1, count - 1)])
    # The bytes of its columns; its trees are not counted.
    per = int(np.prod(shape)) + 2 + 4 + 4
    return lambda: buffer.sample(32, 0.4), per


def tianshou_images(frames: NDArray[np.uint8]) -> tuple[Call, float]:
    from tianshou.data import Batch, ReplayBuffer

    count = len(frames)
    buffer: Any = ReplayBuffer(count, ignore_obs_next=True)
    zeros, flags = np.zeros(count, np.float32), np.zeros(count, bool)
    kept = Batch(obs=frames, act=zeros, rew=zeros, terminated=flags, truncated=flags, done=flags, info={})
    buffer.set_batch(kept)
    buffer._size = count
    return lambda: buffer.sample(32), sum(part.nbytes for part in (frames, zeros, zeros, flags, flags, flags)) / count


def torchrl_images(frames: NDArray[np.uint8]) -> tuple[Call, float]:
    import torch
    from tensordict import TensorDict
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

    count = len(frames)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(count), batch_size=32)
    given = torch.from_numpy(frames)
    for begin in range(0, count, 1_000):
        part = given[begin : begin + 1_000]
        zeros, flags = torch.zeros(len(part)), torch.zeros(len(part), dtype=torch.bool)
        after = {"observation": part.roll(-1, 0), "reward": zeros, "done": flags, "terminated": flags}
        buffer.extend(
            TensorDict({"observation": part, "action": zeros, "next": TensorDict(after, [len(part)])}, [len(part)])
        )
    per = sum(part.nbytes for part in buffer[:1].values(include_nested=True, leaves_only=True))
    return lambda: buffer.sample(), per


def rates(calls: dict[str, Call], rounds: int, seconds: float) -> dict[str, float]:
    """Calls per CPU second of each: the median over rounds in which they take turns."""
    found: dict[str, list[float]] = {name: [] for name in calls}
    orders = itertools.cycle([list(calls), list(calls)[::-1]])
    for number in range(rounds + 1):
        for name in next(orders):
            call, done = calls[name], 0
            started = time.process_time()
            while (passed := time.process_time() - started) < seconds:
                for _ in range(8):
                    call()
                done += 8
            # The first round compiles and fills caches.
            if number:
                found[name].append(done / passed)
    return {name: statistics.median(values) for name, values in found.items()}


def made(makers: dict[str, Callable[[], Any]], console: Console) -> dict[str, Any]:
    """The result of each maker; prints the names of the libraries that are not installed."""
    found = {}
    for name, make in makers.items():
        try:
            found[name] = make()
        except (ImportError, OSError, RuntimeError, AttributeError, TypeError) as error:
            if name.startswith(OURS):
                raise
            console.print(f"left out: {name}: {type(error).__name__}: {(str(error).splitlines() or [''])[0]}")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.replay", description=__doc__)
    parser.add_argument("--priorities", type=int, default=1_000_000)
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--seconds", type=float, default=0.3, help="seconds of each library per round")
    options = parser.parse_args(arguments)
    console = Console(width=120, file=sys.stdout)
    broken: list[str] = []
    table = Table(title=f"sample and update, calls/s, {options.priorities:,} priorities")
    for column in ("", "batch 32", "batch 256"):
        table.add_column(column, justify="left" if not column else "right")
    others = {"Tianshou": tianshou_priorities, "cpprb": cpprb_priorities, "torchrl": torchrl_priorities}
    sampled: dict[str, list[float]] = {}
    for batch in (32, 256):
        makers = {OURS: our_priorities, **others}
        calls = made({name: partial(make, options.priorities, batch) for name, make in makers.items()}, console)
        for name, rate in rates(calls, options.rounds, options.seconds).items():
            sampled.setdefault(name, []).append(rate)
    for name, values in sampled.items():
        table.add_row(name, *(f"{value:,.0f}" for value in values))
    for place, batch in enumerate((32, 256)):
        peers = {name: values[place] for name, values in sampled.items() if name != OURS}
        if peers and sampled[OURS][place] < max(peers.values()):
            broken.append(f"{max(peers, key=lambda name: peers[name])} samples faster at batch size {batch}")
    console.print(table)
    frames = tetris_frames(options.frames)
    images = made(
        {
            f"{OURS}, packed": lambda: our_images(frames, True),
            f"{OURS}, raw": lambda: our_images(frames, False),
            "stable-baselines3 (uniform)": lambda: sb3_images(frames),
            "cpprb": lambda: cpprb_images(frames),
            "Tianshou (uniform)": lambda: tianshou_images(frames),
            "torchrl (uniform)": lambda: torchrl_images(frames),
        },
        console,
    )
    found = rates({name: call for name, (call, _) in images.items()}, options.rounds, options.seconds)
    table = Table(title=f"image minibatches of 32, {len(frames):,} transitions of Tetris variants")
    for column in ("", "minibatches/s", "bytes per transition"):
        table.add_column(column, justify="left" if not column else "right")
    for name, rate in found.items():
        table.add_row(name, f"{rate:,.0f}", f"{images[name][1]:,.0f}")
    console.print(table)
    packed = f"{OURS}, packed"
    if images[packed][1] > BYTES:
        broken.append(f"a packed transition takes {images[packed][1]:,.0f} bytes; at most {BYTES:,}")
    sb3, raw = found.get("stable-baselines3 (uniform)"), found[f"{OURS}, raw"]
    if sb3 is not None and raw < sb3:
        broken.append(f"stable-baselines3 gives {sb3 / raw:.2f} times as many image minibatches a second")
    ratio = update_ratio(frames, options.rounds)
    console.print(f"an update on packed frames takes {ratio:.3f} times as long as on raw frames")
    if ratio > UPDATE:
        broken.append(f"an update on packed frames takes {ratio:.3f} times as long as on raw frames; at most {UPDATE}")
    for words in broken:
        console.print(f"limit broken: {words}")
    return int(bool(broken))


if __name__ == "__main__":
    raise SystemExit(main())
