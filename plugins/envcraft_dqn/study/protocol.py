"""The protocol of a study as plain data, and its tasks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import msgspec

from envcraft.errors import UsageError
from envcraft_dqn.settings import Settings
from envcraft_dqn.study.folds import Split, sample, splits, subset

#: Baselines of an agent.
RANDOM, PRIVILEGED, UNTRAINED, NOOP = "random", "privileged", "untrained", "noop"
#: The agent, the agent after pretraining, and the agent in environments of its training.
AGENT, PRETRAINED, FAMILIAR = "agent", "pretrained", "familiar"
#: Agents with other trainings.
WITHOUT, SEED, SUBSET = "without demonstrations", "seed", "subset"


class Protocol(msgspec.Struct, frozen=True, kw_only=True, rename={"num_envs": "lanes"}):
    """The protocol of a study.

    Attributes:
        scale: The name of the preset.
        variants: The number of environments.
        folds: The number of folds.
        episodes: The episodes of each environment by random play and by each agent.
        privileged_episodes: The episodes of each environment by the privileged player.
        num_envs: The environments to step in parallel; ``lanes`` in files.
        epsilon: The rate of random actions of agents in tests.
        seed: The seed of all random numbers.
        seeds: The number of agents per split with different seeds. All but the first are controls.
        controls: The number of splits with the controls that need training.
        familiar: The number of environments of its training on which each agent is tested as well.
        subsets: Sizes of training sets, each with a number of splits.
        metric: ``length`` or ``return``.
        threads: The threads of each task.
        settings: The settings of each training.
    """

    scale: str
    variants: int
    folds: int
    episodes: int
    privileged_episodes: int
    num_envs: int = 16
    epsilon: float = 0.0
    seed: int = 0
    seeds: int = 2
    controls: int = 1
    familiar: int
    subsets: tuple[tuple[int, int], ...] = ()
    metric: str = "length"
    threads: int = 1
    settings: Settings

    def check(self) -> None:
        """Raises UsageError for invalid or incompatible values."""
        self.settings.check()
        if not self.settings.pretrain_updates:
            raise UsageError("a study pretrains on demonstrations: --pretrain-updates must be 1 or more")
        if self.metric == "return" and not self.privileged_episodes:
            raise UsageError("the metric return needs the privileged player: --privileged-episodes must be 2 or more")
        for name in ("controls", *(["subsets"] if self.subsets else [])):
            most = self.controls if name == "controls" else max(count for _, count in self.subsets)
            if most > self.folds:
                raise UsageError(f"{name} in {most} splits need at least {most} --folds, not {self.folds}")


class Task(msgspec.Struct, frozen=True):
    """A unit of work.

    Attributes:
        name: The name, which is also that of the result file.
        kind: ``train`` an agent on environments, or ``play`` in them.
        condition: The condition that the task belongs to.
        split: The number of the split.
        environments: The names of the environments.
        player: For ``play``: random, noop, privileged, untrained, or the file of an agent in the folder of the study.
        seed: The seed of the training or of the episodes.
        demonstrations: For ``train``: whether there are demonstrations.
        after: The names of the tasks that must be done first.
    """

    name: str
    kind: Literal["train", "play"]
    condition: str
    split: int
    environments: tuple[str, ...]
    player: str = ""
    seed: int = 0
    demonstrations: bool = True
    after: tuple[str, ...] = ()


def tasks(protocol: Protocol, names: Sequence[str]) -> list[Task]:
    """All tasks of a study over named environments.

    The order is that of priority: random play, agents, controls. Dependencies come first.

    Raises:
        UsageError: The protocol is invalid, or there are too few environments.
    """
    protocol.check()
    parts = splits(names, protocol.folds, protocol.seed)
    found = [_play(protocol, split, RANDOM, split.test, RANDOM) for split in parts]
    trainings = [(split, training) for split in parts for training in _trainings(protocol, split)]
    for split, training in sorted(trainings, key=lambda pair: pair[1].condition != AGENT):
        found += [training, *_plays(protocol, split, training)]
    for split in parts:
        players = [UNTRAINED, NOOP, *([PRIVILEGED] if protocol.privileged_episodes else [])]
        found += [_play(protocol, split, player, split.test, player) for player in players]
    return found


def training_settings(protocol: Protocol, task: Task) -> Settings:
    """The settings of one training. Without demonstrations, it explores more."""
    settings = msgspec.structs.replace(protocol.settings, seed=task.seed)
    if task.demonstrations:
        return settings
    return msgspec.structs.replace(
        settings, pretrain_updates=0, epsilon_first=1.0, epsilon_share=0.5, demonstration_share=None
    )


def _trainings(protocol: Protocol, split: Split) -> Iterator[Task]:
    """The trainings of a split: the agent, and its controls."""
    first = protocol.seed
    yield _training(split, AGENT, split.train, first)
    if split.number < protocol.controls:
        yield _training(split, WITHOUT, split.train, first, demonstrations=False)
        for number in range(1, protocol.seeds):
            yield _training(split, f"{SEED} {number + 1}", split.train, first + number)
    for size, count in protocol.subsets:
        if split.number < count:
            yield _training(split, f"{SUBSET} {size}", subset(split, size, protocol.seed), first)


def _training(
    split: Split, condition: str, environments: tuple[str, ...], seed: int, demonstrations: bool = True
) -> Task:
    name = _name(split, "train", condition)
    return Task(name, "train", condition, split.number, environments, seed=seed, demonstrations=demonstrations)


def _plays(protocol: Protocol, split: Split, training: Task) -> Iterator[Task]:
    """The tests of an agent."""
    agent = f"runs/{training.name}/agent.safetensors"
    yield _play(protocol, split, training.condition, split.test, agent, training.name)
    if training.condition == AGENT:
        before = f"runs/{training.name}/pretrained.safetensors"
        yield _play(protocol, split, PRETRAINED, split.test, before, training.name)
        if known := sample(split, protocol.familiar, protocol.seed):
            yield _play(protocol, split, FAMILIAR, known, agent, training.name)


def _play(
    protocol: Protocol, split: Split, condition: str, environments: tuple[str, ...], player: str, after: str = ""
) -> Task:
    return Task(
        _name(split, "play", condition),
        "play",
        condition,
        split.number,
        environments,
        player,
        # Random play and agents need independent games.
        protocol.seed + 1_000 * (1 + split.number) + (player != RANDOM),
        after=(after,) if after else (),
    )


def _name(split: Split, kind: str, condition: str) -> str:
    return f"split-{split.number:02}.{kind}.{condition.replace(' ', '-')}"
