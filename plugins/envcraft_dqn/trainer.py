"""The training loop: demonstrations, turns in parallel environments, updates and checkpoints. Imports torch.

The entry point is :func:`train`. The learner is in :mod:`envcraft_dqn.learner`, and the replay in
:mod:`envcraft_dqn.replay`.
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from envcraft.errors import EnvCraftError, UsageError
from envcraft_dqn.callbacks import Callback
from envcraft_dqn.checkpoint import Checkpoint, load_agent, save_agent
from envcraft_dqn.demonstrations import Adviser, DemonstrationSource, identity, seed_replay
from envcraft_dqn.env_spec import EnvSpec, OpenVector, advises
from envcraft_dqn.frames import Frames, make_store
from envcraft_dqn.held_out import HeldOut
from envcraft_dqn.learner import Learner
from envcraft_dqn.replay import MOST_ACTIONS, Replay
from envcraft_dqn.settings import Settings

#: Pretraining updates between two checks of the clock.
_CHUNK = 50
#: The name of the actions of the running turn in a checkpoint.
_ACTIONS = "turn.actions"


class Diverged(EnvCraftError):
    """The loss is not finite."""


class Position(msgspec.Struct):
    """The number of completed steps, updates and turns of a run."""

    steps: int = 0
    updates: int = 0
    turns: int = 0


@dataclass(frozen=True)
class Turn:
    """A number of steps (``Settings.cycle``) in parallel environments, from fresh seeds."""

    number: int
    names: tuple[str, ...]
    seeds: list[int]


def schedule(names: Sequence[str], settings: Settings) -> Iterator[Turn]:
    """Yield turns without end. Environments take turns in shuffled cycles, `num_envs` at a time."""
    rng = np.random.default_rng([settings.seed, 1])
    waiting: list[str] = []
    for number in itertools.count():
        while len(waiting) < settings.num_envs:
            waiting += [names[place] for place in rng.permutation(len(names))]
        chosen, waiting = tuple(waiting[: settings.num_envs]), waiting[settings.num_envs :]
        seeds = np.random.SeedSequence([settings.seed, 2, number]).generate_state(settings.num_envs) >> 1
        yield Turn(number, chosen, seeds.tolist())


def train(
    settings: Settings,
    names: Sequence[str],
    open_vector: OpenVector,
    folder: Path,
    demonstrations: DemonstrationSource | None = None,
    callback: Callback | None = None,
    every: float = 300.0,
    sources: Mapping[str, str] | None = None,
    adviser: Adviser | None = None,
    initial: Path | None = None,
    held_out: HeldOut | None = None,
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
        adviser: Labels the states of the learner, for the objective ``dagger``; None if the vector itself advises (see
            :meth:`envcraft.environments.families.Family.simulate`).
        initial: The file of an agent whose weights the network starts with; by default they are random.
        held_out: Tests the agent during training in environments that it does not train on, and keeps the best one.

    Raises:
        UsageError: The folder has another run, or the settings or environments are not supported.
        Diverged: The loss is not finite.
    """
    settings.check()
    if settings.pretrain_updates and demonstrations is None:
        raise UsageError(f"{settings.pretrain_updates:,} updates of pretraining need demonstrations")
    if settings.demonstration_share is not None and demonstrations is None:
        raise UsageError("--demonstration-share needs demonstrations: name their player by --demos, or omit the share")
    if settings.objective in ("bc", "dqfd") and demonstrations is None:
        raise UsageError(f"--objective {settings.objective} needs demonstrations: name their player by --demos")
    if settings.objective == "dagger" and adviser is None and not advises(open_vector, names[0]):
        raise UsageError("--objective dagger needs a player that advises: name it by --demos")
    spec = EnvSpec.of(open_vector, names[0])
    if spec.num_actions > MOST_ACTIONS:
        raise UsageError(
            f"{names[0]} has {spec.num_actions:,} joint actions, and an agent supports at most {MOST_ACTIONS:,}"
        )
    source = "none" if demonstrations is None else identity(demonstrations, names)
    first = "random" if initial is None else sha256(initial.read_bytes()).hexdigest()[:16]
    checkpoint = Checkpoint(folder / "checkpoint", settings, names, every, sources, source, first)
    run = _Run(settings, names, open_vector, folder, spec, checkpoint, callback or Callback(), adviser, held_out)
    if initial is not None:
        run.learner.start_from(*load_agent(initial))
    if checkpoint.exists:
        run.restore()
    elif demonstrations is not None:
        seed_replay(run.replay, spec, names, demonstrations, settings)
        run.save()
    run.pretrain()
    run.play()
    return save_agent(folder / "agent.safetensors", run.learner.network, spec, run.learner.precision)


class _Run:
    """The state of one training: the learner, the replay, the random generator and the position."""

    def __init__(
        self,
        settings: Settings,
        names: Sequence[str],
        open_vector: OpenVector,
        folder: Path,
        spec: EnvSpec,
        checkpoint: Checkpoint,
        callback: Callback,
        adviser: Adviser | None,
        held_out: HeldOut | None,
    ) -> None:
        self._adviser, self._held_out = adviser, held_out
        self._settings, self._names, self._open, self._folder = settings, names, open_vector, folder
        self._spec, self._checkpoint, self._callback = spec, checkpoint, callback
        self.learner = Learner(settings, spec)
        store = make_store(settings.replay, settings.capacity, spec.shape, folder, self.learner.device)
        advised = spec.num_actions if settings.objective == "dagger" else 0
        self.replay = Replay(store, settings.capacity, settings.n_step, settings.gamma, settings.alpha, advised)
        self._rng = np.random.default_rng([settings.seed, 0])
        self._position = Position()
        #: The joint actions [num_envs] of each step of the running turn, and a digest of the frames after them.
        self._actions: list[NDArray[np.int64]] = []
        self._digest = ""

    def save(self) -> None:
        """Write a checkpoint."""
        numbers = msgspec.to_builtins(self._position)
        numbers |= {"rng": self._rng.bit_generator.state, "precision": self.learner.precision, "frames": self._digest}
        tensors = self.learner.state()
        if self._actions:
            tensors[_ACTIONS] = torch.from_numpy(np.stack(self._actions))
        self._checkpoint.save(numbers, tensors, self.replay)

    def restore(self) -> None:
        """Resume from the checkpoint. Raises UsageError for that of another run."""
        self.replay.reset(self._settings.num_envs)
        with self._checkpoint.reading():
            numbers, tensors = self._checkpoint.load(self.replay)
            actions = tensors.pop(_ACTIONS, None)
            self._actions = [] if actions is None else list(actions.numpy())
            # The precision of the machine that started the run, which may have been another one.
            self.learner.bf16 = numbers.pop("precision") == "bf16"
            self._digest = str(numbers.pop("frames"))
            self.learner.restore(tensors)
            self._rng.bit_generator.state = numbers.pop("rng")
            self._position = msgspec.convert(numbers, Position)

    def pretrain(self) -> None:
        """Make the updates on demonstrations alone."""
        settings, position, callback = self._settings, self._position, self._callback
        callback.on_phase_start("pretraining", position.updates, settings.pretrain_updates, position.updates)
        while position.updates < settings.pretrain_updates:
            for _ in range(min(_CHUNK, settings.pretrain_updates - position.updates)):
                self._update()
            callback.on_progress(position.steps, position.updates, position.updates)
            done = position.updates == settings.pretrain_updates
            if done:
                self.learner.synchronise()
                file = self._folder / "pretrained.safetensors"
                save_agent(file, self.learner.network, self._spec, self.learner.precision)
            if done or self._checkpoint.due:
                self.save()

    def play(self) -> None:
        """Make the online steps with their updates."""
        settings, position = self._settings, self._position
        self._callback.on_phase_start("training", position.steps, settings.steps, position.updates)
        with contextlib.ExitStack() as stack:
            opened: tuple[str, ...] = ()
            for turn in itertools.islice(schedule(self._names, settings), position.turns, None):
                if position.steps >= settings.steps:
                    break
                if turn.names != opened:
                    stack.close()
                    envs: Any = stack.enter_context(contextlib.closing(self._open(turn.names)))
                    opened = turn.names
                if settings.objective == "dagger":
                    self._aggregate(turn, envs)
                else:
                    self._take(turn, envs)
                if self._checkpoint.due or position.steps >= settings.steps:
                    self.save()
        if not self._checkpoint.exists:
            self.save()

    def _aggregate(self, turn: Turn, envs: Any) -> None:
        """Play one episode in each environment, label it, add it to the replay, and make the updates.

        A turn starts over after an interruption, so that nothing of it is saved.
        """
        settings, position = self._settings, self._position
        count = settings.num_envs
        frames, _ = envs.reset(seed=turn.seeds)
        self.replay.reset(count)
        self._callback.on_reset(count, turn.names)
        episodes = [_Played([frame.copy()]) for frame in frames]
        running, following = np.arange(count), np.ones(count, np.bool_)
        if self._adviser is None:
            following = self._rng.random(count) >= settings.lead
        for _ in range(settings.cycle):
            active = np.zeros(count, np.bool_)
            active[running] = True
            actions = np.zeros(count, np.int64)
            if self._adviser is None:
                advice = envs.unwrapped.advise(active)
                actions = advice.argmax(1)
                for index in running.tolist():
                    episodes[index].advice.append(advice[index])
            if (deciding := np.flatnonzero(active & following)).size:
                actions[deciding], gaps = self.learner.decide(frames[deciding], self._rng)
                self._callback.on_act(actions[deciding], gaps)
            at_random = self._rng.random(count) < settings.epsilon(position.steps)
            actions = np.where(at_random, self._rng.integers(0, self._spec.num_actions, count), actions)
            frames, rewards, terminated, truncated, _ = envs.step(self._spec.split(actions))
            for index in running.tolist():
                episodes[index].add(frames[index].copy(), actions[index], rewards[index], terminated[index])
            ends = active & (terminated | truncated)
            self._callback.on_step(running, rewards, ends)
            position.steps += len(running)
            running = running[~ends[running]]
            if not running.size:
                break
        for episode, labels in zip(episodes, self._labels(turn, episodes), strict=True):
            if labels is not None:
                advised = labels if np.issubdtype(labels.dtype, np.floating) else None
                joint = self._spec.join(labels) if advised is None else advised.argmax(1)
                rewarded = np.array(episode.rewards, np.float64)
                taken = np.array(episode.actions, np.int64)
                self.replay.add_episode(np.stack(episode.frames), taken, rewarded, episode.terminated, joint, advised)
        due = position.steps // settings.train_every
        while self.replay.drawable and position.updates - settings.pretrain_updates < due:
            self._update()
            self._callback.on_progress(position.steps, position.updates, position.steps)
        position.turns += 1

    def _labels(self, turn: Turn, episodes: Sequence[_Played]) -> Sequence[NDArray[Any] | None]:
        """The advice on the episodes of a turn; see :meth:`Adviser.advise`."""
        if self._adviser is None:
            return [np.stack(episode.advice) for episode in episodes]
        split = [self._spec.split(np.array(episode.actions)) for episode in episodes]
        return self._adviser.advise(list(zip(turn.names, turn.seeds, split, strict=True)))

    def _take(self, turn: Turn, envs: Any) -> None:
        """Play one turn, or the rest of it."""
        settings, position, replay = self._settings, self._position, self.replay
        frames, dones = self._begin(turn, envs)
        first_update = 0 if settings.pretrain_updates else settings.starts
        while len(self._actions) < settings.cycle:
            if position.steps >= settings.steps:
                break
            if self._actions and len(self._actions) % settings.segment == 0 and self._checkpoint.due:
                self._digest = _digest(frames)
                self.save()
            actions, gaps = self.learner.decide(frames)
            self._callback.on_act(actions, gaps)
            at_random = self._rng.random(settings.num_envs) < settings.epsilon(position.steps)
            actions = np.where(at_random, self._rng.integers(0, self._spec.num_actions, settings.num_envs), actions)
            self._actions.append(actions)
            # This step only resets the environments whose episodes ended.
            active = np.flatnonzero(~dones)
            # Indexing copies the frames, which the vector may overwrite.
            before = frames[active]
            frames, rewards, terminated, truncated, _ = envs.step(self._spec.split(actions))
            results = rewards[active], terminated[active], truncated[active]
            replay.add(active, before, actions[active], *results, frames[active])
            dones = terminated | truncated
            position.steps += len(active)
            self._callback.on_step(active, rewards, dones)
            due = max(position.steps - first_update, 0) // settings.train_every
            # The first return of an environment is known some steps after its first step.
            while replay.drawable and position.updates - settings.pretrain_updates < due:
                self._update()
            epsilon = settings.epsilon(position.steps)
            self._callback.on_progress(position.steps, position.updates, position.steps, epsilon)
        replay.truncate(np.arange(settings.num_envs), frames)
        position.turns += 1
        self._actions.clear()

    def _begin(self, turn: Turn, envs: Any) -> tuple[Frames, NDArray[np.bool_]]:
        """Reset the environments; return their frames, and which episodes have ended.

        After an interruption, the actions of the turn are played again, because environments cannot be saved.
        """
        count = self._settings.num_envs
        frames, _ = envs.reset(seed=turn.seeds)
        dones = np.zeros(count, np.bool_)
        self._callback.on_reset(count, turn.names)
        for actions in self._actions:
            active = np.flatnonzero(~dones)
            frames, rewards, terminated, truncated, _ = envs.step(self._spec.split(actions))
            dones = terminated | truncated
            self._callback.on_step(active, rewards, dones)
        if not self._actions or _digest(frames) != self._digest:
            # Environments that are not deterministic go on elsewhere, so that the running episodes are dropped.
            self.replay.reset(count)
        return frames, dones

    def _update(self) -> None:
        settings, position = self._settings, self._position
        share = settings.demonstration_share if position.updates >= settings.pretrain_updates else None
        beta = settings.annealed_beta(position.updates)
        batch = self.replay.sample(settings.batch, beta, self._rng, share, following=not settings.imitates)
        self.learner.anneal(position.updates / max(settings.updates, 1))
        errors, loss = self.learner.update(batch)
        if not math.isfinite(loss):
            raise Diverged(
                f"the loss of update {position.updates + 1:,} is {loss}: are all rewards finite? If so, use a smaller "
                f"--learning-rate than {settings.learning_rate:g} and another --output"
            )
        self.replay.update(batch.slots, errors)
        position.updates += 1
        if position.updates % settings.target_every == 0:
            self.learner.synchronise()
        self._callback.on_update(loss)
        if self._held_out is not None and position.updates % self._held_out.every == 0:
            score = self._held_out.test(self.learner, self._spec, position.updates)
            self._callback.on_held_out(score, position.updates)


@dataclass
class _Played:
    """An episode in the making."""

    frames: list[NDArray[np.uint8]]
    actions: list[int] = field(default_factory=list)
    rewards: list[float] = field(default_factory=list)
    terminated: bool = False
    #: What the vector advised before each action, if it does.
    advice: list[NDArray[np.float32]] = field(default_factory=list)

    def add(self, frame: NDArray[np.uint8], action: Any, reward: Any, terminated: Any) -> None:
        self.frames.append(frame)
        self.actions.append(int(action))
        self.rewards.append(float(reward))
        self.terminated = bool(terminated)


def _digest(frames: Frames) -> str:
    return sha256(frames.tobytes()).hexdigest()
