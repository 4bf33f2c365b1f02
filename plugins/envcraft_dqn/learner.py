"""A duelling double DQN over many environments. Imports torch.

The entry point is :func:`train`. The network is in :mod:`envcraft_dqn.network`, and the replay in
:mod:`envcraft_dqn.replay`.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from envcraft.errors import EnvCraftError, UsageError
from envcraft_dqn.callbacks import Callback
from envcraft_dqn.checkpoint import Checkpoint, save_agent
from envcraft_dqn.demonstrations import DemonstrationSource, identity, seed_replay
from envcraft_dqn.env_spec import EnvSpec, OpenVector
from envcraft_dqn.frames import Frames, make_store
from envcraft_dqn.network import Network, keep_memory, seeded_weights
from envcraft_dqn.replay import MOST_ACTIONS, Batch, Replay
from envcraft_dqn.settings import Settings

#: Pretraining updates between two checks of the clock.
_CHUNK = 50


class Diverged(EnvCraftError):
    """The loss is not finite."""


class Learner:
    """The online network with its optimiser, and the target network."""

    def __init__(self, settings: Settings, spec: EnvSpec) -> None:
        self.settings = settings
        self.device = device_named(settings.device)
        if self.device.type == "cpu":
            keep_memory()
        with seeded_weights(settings.seed):
            networks = [Network(spec.shape, spec.choices, settings.size, settings.head) for _ in range(2)]
        self.network, self.target = (network.on_device(self.device) for network in networks)
        self.target.load_state_dict(self.network.state_dict())
        self.target.requires_grad_(False)
        # The epsilon of Hessel et al. 2018 (arXiv:1710.02298).
        self.optimiser = torch.optim.Adam(self.network.parameters(), settings.learning_rate, eps=1.5e-4, fused=True)
        self.bf16 = settings.precision == "bf16" or (settings.precision == "auto" and _faster_in_bf16(self.device))
        self._loss = torch.compile(self._eager_loss) if settings.compiled else self._eager_loss

    def act(self, frames: Frames) -> NDArray[np.int64]:
        """The greedy joint actions [n] for `frames` [n, *shape]."""
        with torch.no_grad(), self._autocast():
            pixels = self.network.preprocess(self._on_device(frames))
            actions: NDArray[np.int64] = self.network.greedy(pixels).cpu().numpy()
        return actions

    def update(self, batch: Batch) -> tuple[NDArray[np.float32], float]:
        """Make one step of the optimiser; return the TD errors [n] of the batch and its loss."""
        arrays = (batch.frames, batch.next_frames, batch.actions, batch.returns, batch.discounts, batch.weights)
        loss, errors = self._loss(*(self._on_device(array) for array in arrays))
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return errors.cpu().numpy(), float(loss.detach())

    def synchronise(self) -> None:
        """Copy the online network to the target network."""
        self.target.load_state_dict(self.network.state_dict())

    def _eager_loss(
        self, frames: Tensor, next_frames: Tensor, actions: Tensor, returns: Tensor, discounts: Tensor, weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The weighted Huber loss of double Q-learning (van Hasselt et al. 2016, arXiv:1509.06461), and TD errors."""
        with self._autocast():
            with torch.no_grad():
                pixels = self.network.preprocess(next_frames)
                best = self.network.greedy(pixels)
                values = self.target.values(pixels).gather(1, best[:, None]).squeeze(1)
            chosen = self.network(frames).gather(1, actions[:, None]).squeeze(1).float()
        targets = returns + discounts * values.float()
        return (
            weights * functional.smooth_l1_loss(chosen, targets, reduction="none")
        ).mean(), targets - chosen.detach()

    def _autocast(self) -> contextlib.AbstractContextManager[Any]:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16)

    def _on_device(self, array: Any) -> Tensor:
        tensor = array if isinstance(array, Tensor) else torch.from_numpy(array)
        return tensor.to(self.device, non_blocking=True)

    def state(self) -> dict[str, Tensor]:
        """All tensors that an update changes, by name."""
        tensors = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        tensors |= {f"target.{name}": value for name, value in self.target.state_dict().items()}
        for number, state in self.optimiser.state_dict()["state"].items():
            tensors |= {f"adam.{number}.{name}": value for name, value in state.items()}
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Restore what :meth:`state` returned. Raises UsageError if it belongs to another architecture."""
        parts: dict[str, dict[str, Tensor]] = {"network": {}, "target": {}, "adam": {}}
        for name, value in tensors.items():
            part, _, rest = name.partition(".")
            parts[part][rest] = value
        try:
            self.network.load_state_dict(parts["network"])
            self.target.load_state_dict(parts["target"])
        except RuntimeError:
            raise UsageError(
                f"the checkpoint has a network {self.settings.size!r} with other layers, from another version of "
                "EnvCraft; train in another folder"
            ) from None
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in parts["adam"].items():
            number, _, field = name.partition(".")
            state.setdefault(int(number), {})[field] = value
        whole = self.optimiser.state_dict()
        self.optimiser.load_state_dict({**whole, "state": state})
        for parameter, values in self.optimiser.state.items():
            # The memory layout of the parameter decides the order of floating-point sums.
            for field in ("exp_avg", "exp_avg_sq"):
                values[field] = torch.empty_like(parameter).copy_(values[field])


class Position(msgspec.Struct, rename={"segments": "legs"}):
    """The number of completed steps, updates and segments of a run."""

    steps: int = 0
    updates: int = 0
    segments: int = 0


@dataclass(frozen=True)
class Segment:
    """A number of steps in parallel environments, from fresh seeds."""

    number: int
    names: tuple[str, ...]
    seeds: list[int]
    steps: int


def schedule(names: Sequence[str], settings: Settings) -> Iterator[Segment]:
    """Yield segments without end. Environments take turns in shuffled cycles, `num_envs` at a time."""
    rng = np.random.default_rng([settings.seed, 1])
    waiting: list[str] = []
    numbers = itertools.count()
    while True:
        while len(waiting) < settings.num_envs:
            waiting += [names[place] for place in rng.permutation(len(names))]
        chosen, waiting = tuple(waiting[: settings.num_envs]), waiting[settings.num_envs :]
        for start in range(0, settings.cycle, settings.segment):
            number = next(numbers)
            seeds = np.random.SeedSequence([settings.seed, 2, number]).generate_state(settings.num_envs) >> 1
            yield Segment(number, chosen, seeds.tolist(), min(settings.segment, settings.cycle - start))


def train(
    settings: Settings,
    names: Sequence[str],
    open_vector: OpenVector,
    folder: Path,
    demonstrations: DemonstrationSource | None = None,
    callback: Callback | None = None,
    every: float = 300.0,
    sources: Mapping[str, str] | None = None,
) -> Path:
    """Train an agent, and return its file.

    An interrupted run in `folder` resumes from its last checkpoint and gives the same agent.

    Args:
        settings: The settings of the run.
        names: The names of the environments.
        open_vector: Makes a vector of named environments with autoreset mode NEXT_STEP.
        folder: The folder for the agent, the checkpoint and ``pretrained.safetensors``, the agent after pretraining.
        demonstrations: Demonstrations, which stay in the replay throughout.
        callback: Receives the events of the run.
        every: The approximate seconds between two checkpoints.
        sources: The identities of the environments by name, to detect changes before resuming.

    Raises:
        UsageError: The folder has another run, or the settings or environments are not supported.
        Diverged: The loss is not finite.
    """
    settings.check()
    callback = callback or Callback()
    if settings.pretrain_updates and demonstrations is None:
        raise UsageError(f"{settings.pretrain_updates:,} updates of pretraining need demonstrations")
    if settings.demonstration_share is not None and demonstrations is None:
        raise UsageError("--demonstration-share needs demonstrations: name their player by --demos, or omit the share")
    spec = EnvSpec.of(open_vector, names[0])
    if spec.num_actions > MOST_ACTIONS:
        raise UsageError(
            f"{names[0]} has {spec.num_actions:,} joint actions, and an agent supports at most {MOST_ACTIONS:,}"
        )
    learner = Learner(settings, spec)
    store = make_store(settings.replay, settings.capacity, spec.shape, folder, learner.device)
    replay = Replay(store, settings.capacity, settings.n_step, settings.gamma, settings.alpha)
    rng = np.random.default_rng([settings.seed, 0])
    source = "none" if demonstrations is None else identity(demonstrations, names)
    checkpoint = Checkpoint(folder / "checkpoint", settings, names, every, sources, source)
    position = Position()

    def save() -> None:
        checkpoint.save(msgspec.to_builtins(position) | {"rng": rng.bit_generator.state}, learner.state(), replay)

    def update() -> None:
        share = settings.demonstration_share if position.updates >= settings.pretrain_updates else None
        batch = replay.sample(settings.batch, settings.annealed_beta(position.updates), rng, share)
        errors, loss = learner.update(batch)
        if not math.isfinite(loss):
            raise Diverged(
                f"the loss of update {position.updates + 1:,} is {loss}: are all rewards finite? If so, use a smaller "
                f"--learning-rate than {settings.learning_rate:g} and another --output"
            )
        replay.update(batch.slots, errors)
        position.updates += 1
        if position.updates % settings.target_every == 0:
            learner.synchronise()
        callback.on_update(loss)

    if checkpoint.exists:
        with checkpoint.reading():
            numbers, tensors = checkpoint.load(replay)
            learner.restore(tensors)
            rng.bit_generator.state = numbers.pop("rng")
            position = msgspec.convert(numbers, Position)
    elif demonstrations is not None:
        seed_replay(replay, spec, names, demonstrations, settings)
        save()

    callback.on_phase_start("pretraining", position.updates, settings.pretrain_updates, position.updates)
    while position.updates < settings.pretrain_updates:
        for _ in range(min(_CHUNK, settings.pretrain_updates - position.updates)):
            update()
        callback.on_progress(position.steps, position.updates, position.updates)
        if position.updates == settings.pretrain_updates:
            learner.synchronise()
            save_agent(folder / "pretrained.safetensors", learner.network, spec)
        if checkpoint.due or position.updates == settings.pretrain_updates:
            save()

    callback.on_phase_start("training", position.steps, settings.steps, position.updates)
    first_update = 0 if settings.pretrain_updates else settings.starts
    with contextlib.ExitStack() as stack:
        opened: tuple[str, ...] = ()
        for segment in itertools.islice(schedule(names, settings), position.segments, None):
            if position.steps >= settings.steps:
                break
            if segment.names != opened:
                stack.close()
                envs: Any = stack.enter_context(contextlib.closing(open_vector(segment.names)))
                opened = segment.names
            frames, _ = envs.reset(seed=segment.seeds)
            replay.reset(settings.num_envs)
            callback.on_reset(settings.num_envs)
            dones = np.zeros(settings.num_envs, np.bool_)
            for _ in range(segment.steps):
                actions = learner.act(frames)
                at_random = rng.random(settings.num_envs) < settings.epsilon(position.steps)
                actions = np.where(at_random, rng.integers(0, spec.num_actions, settings.num_envs), actions)
                # This step only resets the environments whose episodes ended.
                active = np.flatnonzero(~dones)
                # Indexing copies the frames, which the vector may overwrite.
                before = frames[active]
                next_frames, rewards, terminated, truncated, _ = envs.step(spec.split(actions))
                results = rewards[active], terminated[active], truncated[active]
                replay.add(active, before, actions[active], *results, next_frames[active])
                frames, dones = next_frames, terminated | truncated
                position.steps += len(active)
                callback.on_step(active, rewards, dones)
                due = max(position.steps - first_update, 0) // settings.train_every
                # The first return of an environment is known some steps after its first step.
                while replay.drawable and position.updates - settings.pretrain_updates < due:
                    update()
                callback.on_progress(position.steps, position.updates, position.steps, settings.epsilon(position.steps))
            # Environments cannot be saved, so that every segment starts with new episodes.
            replay.truncate(np.arange(settings.num_envs), frames)
            position.segments += 1
            if checkpoint.due or position.steps >= settings.steps:
                save()
    if not checkpoint.exists:
        save()
    return save_agent(folder / "agent.safetensors", learner.network, spec)


def device_named(name: str) -> torch.device:
    """A torch device by name; ``auto`` is the GPU if there is one. Raises UsageError."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        torch.empty(0, device=name)
        return torch.device(name)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name} is not available: {str(error).splitlines()[0]}") from None


def _faster_in_bf16(device: torch.device) -> bool:
    """Whether bfloat16 is faster: on GPUs, and on CPUs with instructions for it. On others it is much slower."""
    if device.type != "cpu":
        return True
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
