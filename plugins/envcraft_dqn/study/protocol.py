"""What a study is made of, as plain data, and the tasks that it comes to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import msgspec

from envcraft.errors import UsageError
from envcraft_dqn.settings import Settings
from envcraft_dqn.study.folds import Split, sample, splits, subset

#: Players that an agent is held against.
RANDOM, PRIVILEGED, UNTRAINED, NOOP = "random", "privileged", "untrained", "noop"
#: What training leads to: the agent, as it was after its demonstrations, and in environments that it was trained on.
AGENT, PRETRAINED, FAMILIAR = "agent", "pretrained", "familiar"
#: The same trained otherwise.
WITHOUT, SEED, SUBSET = "without demonstrations", "seed", "subset"


class Protocol(msgspec.Struct, frozen=True, kw_only=True):
    """A study.

    Attributes:
        scale: what it was made from.
        variants: environments that are written where no corpus is named.
        folds: parts of the partition.
        episodes: of each environment, by random play and by each agent.
        privileged_episodes: of each environment, by the privileged player.
        lanes: episodes side by side.
        epsilon: random actions of agents that are tested.
        seed: of everything that is drawn.
        seeds: agents of each split that differ in their seed alone; those after the first are a control.
        controls: splits in which the controls are trained that take a training of their own.
        familiar: environments of each split's training that its agent is tested on, too.
        subsets: how many environments are trained on, in how many splits.
        metric: ``length`` or ``return``.
        threads: of each task.
        settings: of each training.
    """

    scale: str
    variants: int
    folds: int
    episodes: int
    privileged_episodes: int
    lanes: int = 16
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
        """Raises UsageError on what does not go together."""
        self.settings.check()
        if not self.settings.pretrain_updates:
            raise UsageError("a study pretrains on demonstrations: take --pretrain-updates of 1 or more")
        if self.metric == "return" and not self.privileged_episodes:
            raise UsageError("returns are put between random and privileged: take --privileged-episodes of 2 or more")
        for name in ("controls", *(["subsets"] if self.subsets else [])):
            most = self.controls if name == "controls" else max(count for _, count in self.subsets)
            if most > self.folds:
                raise UsageError(f"{name} in {most} splits need as many --folds, which are {self.folds}")


class Task(msgspec.Struct, frozen=True):
    """One thing to do, after the tasks named in `after`.

    Attributes:
        name: which also names the file of its result.
        kind: ``train`` an agent on environments, or ``play`` in them.
        condition: what it is for.
        split: which one.
        environments: their names.
        player: of ``play``: random, noop, privileged, untrained, or the file of an agent, below the study's folder.
        seed: of the training, or of the episodes.
        demonstrations: of ``train``: whether there are any.
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
    """All tasks, in the order in which they are best begun: what the others are held against, agents, controls. None
    comes before one that it waits for. Raises UsageError where the names do not suffice.
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
    """Those of one training. Without demonstrations there is nothing to begin with but chance."""
    settings = msgspec.structs.replace(protocol.settings, seed=task.seed)
    if task.demonstrations:
        return settings
    return msgspec.structs.replace(
        settings, pretrain_updates=0, epsilon_first=1.0, epsilon_share=0.5, demonstration_share=None
    )


def _trainings(protocol: Protocol, split: Split) -> Iterator[Task]:
    """The trainings of a split: the agent, and controls where they are due."""
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
    """What an agent is tested on, and as what."""
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
        # Random play and an agent are not to see the same games by accident.
        protocol.seed + 1_000 * (1 + split.number) + (player != RANDOM),
        after=(after,) if after else (),
    )


def _name(split: Split, kind: str, condition: str) -> str:
    return f"split-{split.number:02}.{kind}.{condition.replace(' ', '-')}"
