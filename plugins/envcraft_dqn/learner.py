"""A duelling double DQN over many environments, from the first demonstration to the last step. Imports torch.

Read :func:`train` from its beginning to its end: the rest is called from there. The network is in
:mod:`envcraft_dqn.network`, the replay in :mod:`envcraft_dqn.replay`.
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
from envcraft_dqn.checkpoint import Checkpoint, save_agent
from envcraft_dqn.demonstrations import DemonstrationSource, identity, seed_replay
from envcraft_dqn.frames import Frames, make_store
from envcraft_dqn.network import Network, keep_memory, weights_from
from envcraft_dqn.replay import MOST_ACTIONS, Batch, Replay
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import OpenVector, Surface
from envcraft_dqn.telling import Teller

#: Updates of pretraining between two looks at the clock.
_CHUNK = 50


class Diverged(EnvCraftError):
    """A loss is no number any more, and nothing that is learnt from it would be."""


class Learner:
    """The online and the target network, and the optimiser of the former."""

    def __init__(self, settings: Settings, surface: Surface) -> None:
        self.settings = settings
        self.device = device_named(settings.device)
        if self.device.type == "cpu":
            keep_memory()
        with weights_from(settings.seed):
            made = [Network(surface.shape, surface.choices, settings.size, settings.head) for _ in range(2)]
        self.network, self.target = (one.placed(self.device) for one in made)
        self.target.load_state_dict(self.network.state_dict())
        self.target.requires_grad_(False)
        # Epsilon as Hessel et al. 2018 (arXiv:1710.02298) have it.
        self.optimiser = torch.optim.Adam(self.network.parameters(), settings.learning_rate, eps=1.5e-4, fused=True)
        self.bf16 = settings.precision == "bf16" or (settings.precision == "auto" and _gains_by_bf16(self.device))
        self._loss = torch.compile(self._eager_loss) if settings.compiled else self._eager_loss

    def act(self, frames: Frames) -> NDArray[np.int64]:
        """The joint action of the highest value for each of `frames` [n, *shape]."""
        with torch.no_grad(), self._casting():
            pixels = self.network.pixels(self._given(frames))
            found: NDArray[np.int64] = self.network.best(pixels).cpu().numpy()
        return found

    def update(self, batch: Batch) -> tuple[NDArray[np.float32], float]:
        """One step of the optimiser; gives the TD errors of the batch, and its loss."""
        arrays = (batch.frames, batch.next_frames, batch.actions, batch.returns, batch.discounts, batch.weights)
        loss, errors = self._loss(*(self._given(array) for array in arrays))
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()
        return errors.cpu().numpy(), float(loss.detach())

    def synchronise(self) -> None:
        """Bring the target network up to date."""
        self.target.load_state_dict(self.network.state_dict())

    def _eager_loss(
        self, frames: Tensor, following: Tensor, actions: Tensor, returns: Tensor, discounts: Tensor, weights: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Weighted Huber loss of double Q-learning (van Hasselt et al. 2016, arXiv:1509.06461), and the TD errors."""
        with self._casting():
            with torch.no_grad():
                pixels = self.network.pixels(following)
                best = self.network.best(pixels)
                values = self.target.values(pixels).gather(1, best[:, None]).squeeze(1)
            chosen = self.network(frames).gather(1, actions[:, None]).squeeze(1).float()
        wanted = returns + discounts * values.float()
        return (weights * functional.smooth_l1_loss(chosen, wanted, reduction="none")).mean(), wanted - chosen.detach()

    def _casting(self) -> contextlib.AbstractContextManager[Any]:
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.bf16)

    def _given(self, array: Any) -> Tensor:
        tensor = array if isinstance(array, Tensor) else torch.from_numpy(array)
        return tensor.to(self.device, non_blocking=True)

    def state(self) -> dict[str, Tensor]:
        """All that an update changes, by name."""
        found = {f"network.{name}": value for name, value in self.network.state_dict().items()}
        found |= {f"target.{name}": value for name, value in self.target.state_dict().items()}
        for number, state in self.optimiser.state_dict()["state"].items():
            found |= {f"adam.{number}.{name}": value for name, value in state.items()}
        return found

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take back what :meth:`state` gave. Raises UsageError where that was of another network."""
        parts: dict[str, dict[str, Tensor]] = {"network": {}, "target": {}, "adam": {}}
        for name, value in tensors.items():
            part, _, rest = name.partition(".")
            parts[part][rest] = value
        try:
            self.network.load_state_dict(parts["network"])
            self.target.load_state_dict(parts["target"])
        except RuntimeError:
            raise UsageError(
                f"the checkpoint is of a network {self.settings.size!r} with other layers, as another version of "
                "EnvCraft has them; train in another folder"
            ) from None
        state: dict[int, dict[str, Tensor]] = {}
        for name, value in parts["adam"].items():
            number, _, field = name.partition(".")
            state.setdefault(int(number), {})[field] = value
        whole = self.optimiser.state_dict()
        self.optimiser.load_state_dict({**whole, "state": state})
        for parameter, values in self.optimiser.state.items():
            # In memory as the parameter is, which decides in what order numbers are added up.
            for field in ("exp_avg", "exp_avg_sq"):
                values[field] = torch.empty_like(parameter).copy_(values[field])


@dataclass
class Position:
    """How far a run has come."""

    steps: int = 0
    updates: int = 0
    legs: int = 0


@dataclass(frozen=True)
class Leg:
    """Environments side by side, from fresh seeds, for some steps each."""

    number: int
    names: tuple[str, ...]
    seeds: list[int]
    steps: int


def schedule(names: Sequence[str], settings: Settings) -> Iterator[Leg]:
    """All legs, without end: the environments in shuffled cycles, as many at a time as there are lanes."""
    rng = np.random.default_rng([settings.seed, 1])
    waiting: list[str] = []
    numbers = itertools.count()
    while True:
        while len(waiting) < settings.lanes:
            waiting += [names[place] for place in rng.permutation(len(names))]
        chosen, waiting = tuple(waiting[: settings.lanes]), waiting[settings.lanes :]
        for begun in range(0, settings.cycle, settings.leg):
            number = next(numbers)
            seeds = np.random.SeedSequence([settings.seed, 2, number]).generate_state(settings.lanes) >> 1
            yield Leg(number, chosen, seeds.tolist(), min(settings.leg, settings.cycle - begun))


def train(
    settings: Settings,
    names: Sequence[str],
    open_vector: OpenVector,
    folder: Path,
    demonstrations: DemonstrationSource | None = None,
    teller: Teller | None = None,
    every: float = 300.0,
    sources: Mapping[str, str] | None = None,
) -> Path:
    """Train an agent on the environments `names`; give the file that it is in.

    A run that was ended in `folder`, by whatever, goes on from its last checkpoint, which is taken about `every`
    seconds, and comes to the same agent. ``pretrained.safetensors`` is what demonstrations alone have led to.

    Args:
        open_vector: makes a vector with autoreset mode NEXT_STEP of environments with these names.
        demonstrations: where there are some, they are in the replay from the beginning, for good.
        sources: by name, what tells an environment from another that comes to have its name.

    Raises UsageError where the folder has another run, or the environments have no frames of bytes; Diverged.
    """
    settings.check()
    teller = teller or Teller()
    if settings.pretrain_updates and demonstrations is None:
        raise UsageError(f"{settings.pretrain_updates:,} updates of pretraining need demonstrations")
    if settings.demonstration_share is not None and demonstrations is None:
        raise UsageError("a share of demonstrations needs some: name their player by --demos, or leave out the share")
    surface = Surface.of(open_vector, names[0])
    if surface.joint > MOST_ACTIONS:
        raise UsageError(
            f"{names[0]} has {surface.joint:,} combinations of its buttons, and an agent learns {MOST_ACTIONS:,} at "
            "the most: make an environment of fewer"
        )
    learner = Learner(settings, surface)
    store = make_store(settings.replay, settings.capacity, surface.shape, folder, learner.device)
    replay = Replay(store, settings.capacity, settings.n_step, settings.gamma, settings.alpha)
    rng = np.random.default_rng([settings.seed, 0])
    told = "none" if demonstrations is None else identity(demonstrations, names)
    checkpoint = Checkpoint(folder / "checkpoint", settings, names, every, sources, told)
    done = Position()

    def save() -> None:
        checkpoint.save(vars(done) | {"rng": rng.bit_generator.state}, learner.state(), replay)

    def update() -> None:
        share = settings.demonstration_share if done.updates >= settings.pretrain_updates else None
        batch = replay.sample(settings.batch, settings.annealed(done.updates), rng, share)
        errors, loss = learner.update(batch)
        if not math.isfinite(loss):
            raise Diverged(
                f"the loss of update {done.updates + 1:,} is {loss}, so nothing more can be learnt: are all rewards "
                f"finite? If so, take a smaller --learning-rate than {settings.learning_rate:g} in another --output"
            )
        replay.update(batch.slots, errors)
        done.updates += 1
        if done.updates % settings.target_every == 0:
            learner.synchronise()
        teller.updated(loss)

    if checkpoint.there:
        with checkpoint.reading():
            numbers, tensors = checkpoint.load(replay)
            learner.restore(tensors)
            rng.bit_generator.state = numbers.pop("rng")
            done = msgspec.convert(numbers, Position)
    elif demonstrations is not None:
        seed_replay(replay, surface, names, demonstrations, settings)
        save()

    teller.begin("pretraining", done.updates, settings.pretrain_updates, done.updates)
    while done.updates < settings.pretrain_updates:
        for _ in range(min(_CHUNK, settings.pretrain_updates - done.updates)):
            update()
        teller.progress(done.steps, done.updates, done.updates)
        if done.updates == settings.pretrain_updates:
            learner.synchronise()
            save_agent(folder / "pretrained.safetensors", learner.network, surface)
        if checkpoint.due or done.updates == settings.pretrain_updates:
            save()

    teller.begin("training", done.steps, settings.steps, done.updates)
    first_update = 0 if settings.pretrain_updates else settings.starts
    with contextlib.ExitStack() as stack:
        opened: tuple[str, ...] = ()
        for leg in itertools.islice(schedule(names, settings), done.legs, None):
            if done.steps >= settings.steps:
                break
            if leg.names != opened:
                stack.close()
                envs: Any = stack.enter_context(contextlib.closing(open_vector(leg.names)))
                opened = leg.names
            frames, _ = envs.reset(seed=leg.seeds)
            replay.lanes(settings.lanes)
            teller.reset(settings.lanes)
            over = np.zeros(settings.lanes, np.bool_)
            for _ in range(leg.steps):
                actions = learner.act(frames)
                at_random = rng.random(settings.lanes) < settings.epsilon(done.steps)
                actions = np.where(at_random, rng.integers(0, surface.joint, settings.lanes), actions)
                # A lane whose episode was over is only reset by this step.
                on = np.flatnonzero(~over)
                # A copy, before a vector that makes none writes into it.
                before = frames[on]
                following, rewards, terminated, truncated, _ = envs.step(surface.split(actions))
                replay.add(on, before, actions[on], rewards[on], terminated[on], truncated[on], following[on])
                frames, over = following, terminated | truncated
                done.steps += len(on)
                teller.stepped(on, rewards, over)
                due = max(done.steps - first_update, 0) // settings.train_every
                # The first return of a lane is known some steps after its first step.
                while replay.drawable and done.updates - settings.pretrain_updates < due:
                    update()
                teller.progress(done.steps, done.updates, done.steps, settings.epsilon(done.steps))
            # Environments cannot be saved: episodes begin anew at each leg, whether the run is interrupted or not.
            replay.cut(np.arange(settings.lanes), frames)
            done.legs += 1
            if checkpoint.due or done.steps >= settings.steps:
                save()
    if not checkpoint.there:
        save()
    return save_agent(folder / "agent.safetensors", learner.network, surface)


def device_named(name: str) -> torch.device:
    """``auto`` is the GPU where there is one. Raises UsageError."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        torch.empty(0, device=name)
        return torch.device(name)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"--device {name} cannot be used here: {str(error).splitlines()[0]}") from None


def _gains_by_bf16(device: torch.device) -> bool:
    """Whether half the bits are quicker: on GPUs, and processors that multiply them. Elsewhere it is much slower."""
    if device.type != "cpu":
        return True
    return bool(torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported())
