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
#: Random moves without buttons, the constant action that is best in the environments of the training, and the agent's
#: own actions in random order.
COIN, CONSTANT, SHUFFLED = "coin flip", "constant", "shuffled"
#: Controls that need no training and do not look at the frame. Competence is a lead over all of them.
BLIND = (NOOP, COIN, CONSTANT, SHUFFLED)
#: The agent, the agent after pretraining, and the agent in environments of its training.
AGENT, PRETRAINED, FAMILIAR = "agent", "pretrained", "familiar"
#: Agents with other trainings.
WITHOUT, SEED, SUBSET = "without demonstrations", "seed", "subset"


class Protocol(msgspec.Struct, frozen=True, kw_only=True, rename={"num_envs": "lanes"}):
    """The protocol of a study.

    Attributes:
        scale: The name of the preset.
        variants: The number of environments.
        where: The values of some axes that all generated environments have, each as ``AXIS=VALUE``.
        folds: The number of folds.
        episodes: The episodes of each environment by random play and by each agent.
        privileged_episodes: The episodes of each environment by the privileged player.
        recorded: The demonstrated steps that are recorded in each environment. Trainings use the first ones, as many
            as the settings have.
        num_envs: The environments to step in parallel; ``lanes`` in files.
        epsilon: The rate of random actions of agents in tests.
        seed: The seed of all random numbers.
        seeds: The number of agents per split with different seeds. All but the first are controls.
        controls: The number of splits with the controls that need training.
        familiar: The number of environments of its training on which each agent is tested as well.
        splits: The number of splits whose agents train and are tested; 0 means all.
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
    recorded: int
    num_envs: int = 16
    epsilon: float = 0.0
    seed: int = 0
    seeds: int = 2
    controls: int = 1
    familiar: int
    splits: int = 0
    subsets: tuple[tuple[int, int], ...] = ()
    where: tuple[str, ...] = ()
    metric: str = "return"
    threads: int = 1
    settings: Settings

    def check(self) -> None:
        """Raises UsageError for invalid or incompatible values."""
        self.settings.check()
        if not self.settings.pretrain_updates and self.settings.objective != "dagger":
            raise UsageError("without --objective dagger, a study pretrains: --pretrain-updates must be 1 or more")
        if self.recorded < self.settings.demonstrations:
            raise UsageError(
                f"--recorded is {self.recorded:,}, but a training uses {self.settings.demonstrations:,} steps"
            )
        if self.metric == "return" and not self.privileged_episodes:
            raise UsageError("the metric return needs the privileged player: --privileged-episodes must be 2 or more")
        if self.splits > self.folds:
            raise UsageError(f"{self.splits} splits need at least {self.splits} --folds, not {self.folds}")
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
        player: For ``play``: random, privileged, untrained, a control of :data:`BLIND`, or the file of an agent in the
            folder of the study.
        seed: The seed of the training or of the episodes.
        demonstrations: For ``train``: whether there are demonstrations.
        after: The names of the tasks that must be done first.
        training: Environments of the training, among which a constant action is chosen.
        initial: For ``train``: the file of the agent to start from, in the folder of the study.
        steps: For ``train``: the online steps, if not those of the settings.
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
    training: tuple[str, ...] = ()
    initial: str = ""
    steps: int | None = None


def tasks(protocol: Protocol, names: Sequence[str]) -> list[Task]:
    """All tasks of a study over named environments.

    The order is that of priority: random play, agents, controls. Dependencies come first.

    Raises:
        UsageError: The protocol is invalid, or there are too few environments.
    """
    protocol.check()
    parts = splits(names, protocol.folds, protocol.seed)[: protocol.splits or None]
    found = [_play(protocol, split, RANDOM, split.test, RANDOM) for split in parts]
    trainings = [(split, training) for split in parts for training in _trainings(protocol, split)]
    for split, training in sorted(trainings, key=lambda pair: pair[1].condition != AGENT):
        found += [training, *_plays(protocol, split, training)]
    for split in parts:
        known = sample(split, protocol.familiar, protocol.seed)
        ceiling = [PRIVILEGED] if protocol.privileged_episodes else []
        for player in (UNTRAINED, *BLIND, *ceiling):
            found.append(_control(protocol, split, player, player, split.test, known))
            if known and player != PRIVILEGED:
                found.append(_control(protocol, split, f"{FAMILIAR} {player}", player, known, known))
        if every := _tested_again(protocol, split):
            found += [_play(protocol, split, f"{FAMILIAR} {one}", every, one) for one in (RANDOM, *ceiling)]
    return found


def _control(
    protocol: Protocol,
    split: Split,
    condition: str,
    player: str,
    environments: tuple[str, ...],
    known: tuple[str, ...],
) -> Task:
    """The test of a control without training."""
    after = _name(split, "play", FAMILIAR if known else AGENT) if player == SHUFFLED else ""
    task = _play(protocol, split, condition, environments, player, after)
    return msgspec.structs.replace(task, training=known or split.train) if player == CONSTANT else task


def _tested_again(protocol: Protocol, split: Split) -> tuple[str, ...]:
    """The environments of the trainings of a split in which agents are tested as well."""
    known = {*sample(split, protocol.familiar, protocol.seed)}
    for size, count in protocol.subsets:
        if split.number < count:
            known |= {*_known_subset(protocol, split, size)}
    return tuple(sorted(known))


def _known_subset(protocol: Protocol, split: Split, size: int) -> tuple[str, ...]:
    return subset(split, size, protocol.seed)[: protocol.familiar]


def training_settings(protocol: Protocol, task: Task) -> Settings:
    """The settings of one training. Without demonstrations, it explores more."""
    settings = msgspec.structs.replace(protocol.settings, seed=task.seed)
    if task.steps is not None:
        # A transfer counts the steps in the new environments, so that nothing else is learned from.
        settings = msgspec.structs.replace(settings, steps=task.steps, pretrain_updates=0, demonstration_share=None)
    if task.demonstrations or task.steps is not None:
        return settings
    return msgspec.structs.replace(
        settings,
        objective="dqn",
        temperature=0.0,
        pretrain_updates=0,
        epsilon_first=1.0,
        epsilon_share=0.5,
        demonstration_share=None,
    )


def _trainings(protocol: Protocol, split: Split) -> Iterator[Task]:
    """The trainings of a split: the agent, and its controls. Every split has seeds of its own."""
    first = protocol.seed + 1_000 * split.number
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
        if protocol.settings.pretrain_updates:
            before = f"runs/{training.name}/pretrained.safetensors"
            yield _play(protocol, split, PRETRAINED, split.test, before, training.name)
        if known := sample(split, protocol.familiar, protocol.seed):
            yield _play(protocol, split, FAMILIAR, known, agent, training.name)
    elif training.condition.startswith(SUBSET) and protocol.familiar:
        size = int(training.condition.rpartition(" ")[2])
        known = _known_subset(protocol, split, size)
        yield _play(protocol, split, f"{FAMILIAR} {training.condition}", known, agent, training.name)


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
