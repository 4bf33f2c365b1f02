"""The settings of a training run, as plain data. Equal settings, environments and machines give equal runs."""

from __future__ import annotations

import math

import msgspec

from envcraft.errors import UsageError


class Architecture(msgspec.Struct, frozen=True):
    """The layers of a network.

    Attributes:
        channels, kernels, strides: The output channels, the kernel size and the stride of each convolution.
        width: The width of each stream of the head.
        standardised: Whether frames are standardised and weights initialised after He et al. 2015 (arXiv:1502.01852).
            Otherwise pixels are in [0, 1], and weights are torch's defaults.
    """

    channels: tuple[int, ...]
    width: int
    kernels: tuple[int, ...] = (3, 3, 3, 3, 3)
    strides: tuple[int, ...] = (2, 2, 2, 2, 1)
    standardised: bool = False


#: The sizes of networks.
SIZES = {
    "tiny": Architecture((8, 16, 16, 32, 32), 64),
    # About as many parameters as the DQN of stable-baselines3 has for these frames.
    "small": Architecture((8, 8, 16, 16, 32), 723),
    # Few operations on large maps, which take most of the time on a CPU.
    "patches": Architecture((16, 32, 64), 192, (4, 3, 3), (4, 2, 2), standardised=True),
    # One place for each cell of a board whose cells have about six pixels, and what is near it.
    "cells": Architecture((32, 32, 32, 16), 128, (6, 1, 3, 3), (6, 1, 1, 1), standardised=True),
    "reference": Architecture((16, 32, 64, 128, 128), 1290),
}
HEADS = ("joint", "branching")
REPLAYS = ("packed", "ram", "mapped", "device")
PRECISIONS = ("auto", "fp32", "bf16")
#: Q-learning, behaviour cloning, dataset aggregation, and Q-learning from demonstrations.
OBJECTIVES = ("dqn", "bc", "dagger", "dqfd")
AUGMENTATIONS = ("none", "shift", "colour", "both", "mixed")
#: Options and keys in files whose attributes have other names.
RENAMED = {"num_envs": "lanes", "segment": "leg"}
_MINIMUM = {
    1: ("num_envs", "cycle", "segment", "batch", "n_step", "train_every", "target_every"),
    0: ("seed", "steps", "pretrain_updates", "demonstrations", "starts"),
}
_FRACTIONS = ("gamma", "epsilon_first", "epsilon_last", "epsilon_share", "alpha", "beta", "demonstration_share", "lead")


class Settings(msgspec.Struct, frozen=True, kw_only=True, rename=RENAMED):
    """The settings of one run. Steps are transitions of single environments, summed over all environments.

    Attributes:
        size, head: The network: a key of :data:`SIZES`, and one of :data:`HEADS`.
        seed: The seed of all random numbers.
        steps: The number of online steps.
        pretrain_updates: The updates on demonstrations alone, before the first online step.
        num_envs: The environments stepped in parallel; ``lanes`` in files and options.
        cycle: The steps of an environment before another takes its place.
        segment: The steps of an environment between two moments at which a checkpoint is possible; ``leg`` in files
            and options.
        batch: The transitions in an update.
        learning_rate: The learning rate of Adam.
        decay: Whether the learning rate falls linearly to zero over all updates.
        gamma: The discount factor.
        n_step: The length of n-step returns.
        train_every: The steps per update.
        target_every: The updates between two copies to the target network.
        epsilon_first, epsilon_last, epsilon_share: The rate of random actions falls linearly from the first value to
            the last within this share of the steps.
        alpha, beta: The exponents of prioritised replay; beta rises to 1 over all updates.
        capacity: The slots of the replay.
        demonstrations: The maximum number of demonstrated transitions of each environment.
        starts: The steps before the first online update, without pretraining.
        demonstration_share: The share of demonstrations in online batches; None leaves it to the priorities.
        replay: The storage of frames, one of :data:`REPLAYS`.
        precision: One of :data:`PRECISIONS`.
        compiled: Whether torch compiles the loss.
        device: The torch device, or ``auto``.
        value_rescaling: Whether values are learned on the scale of Pohlen et al. 2018 (arXiv:1805.11593), which lets
            one network fit environments with large and with small rewards.
        objective: One of :data:`OBJECTIVES`. ``bc`` and ``dagger`` learn the labelled actions by cross-entropy alone,
            with the values as logits; ``dqfd`` adds a large-margin loss to that of Q-learning (Hester et al. 2018,
            arXiv:1704.03732). ``bc`` has no online steps. With ``dagger`` (Ross et al. 2011, arXiv:1011.0686), the
            privileged player labels the states that the learner visits.
        margin: The margin between the value of a labelled action and the values of others.
        balanced: Whether rare actions weigh more in the loss of labelled actions, by the inverse square root of their
            frequency (Mahajan et al. 2018, arXiv:1805.00932).
        temperature: The temperature at which an agent that only imitates draws actions from the softmax of its values;
            0 means the action with the highest value. A greedy imitator of a demonstrator that mostly waits waits too
            long where it is unsure.
        augment: Random changes to frames, one of :data:`AUGMENTATIONS` (Laskin et al. 2020, arXiv:2004.14990).
        lead: The share of episodes that the advice plays, if the vector advises; the learner plays the others. While it
            plays badly, its own episodes have no states of good play.
    """

    size: str = "small"
    head: str = "joint"
    seed: int = 0
    steps: int = 1_000_000
    pretrain_updates: int = 0
    num_envs: int = 16
    cycle: int = 10_000
    segment: int = 1_000
    batch: int = 32
    learning_rate: float = 3e-4
    decay: bool = False
    gamma: float = 0.99
    n_step: int = 3
    train_every: int = 4
    target_every: int = 2_000
    epsilon_first: float = 1.0
    epsilon_last: float = 0.1
    epsilon_share: float = 0.1
    alpha: float = 0.6
    beta: float = 0.4
    capacity: int = 1_000_000
    demonstrations: int = 1_000
    starts: int = 1_000
    demonstration_share: float | None = None
    replay: str = "packed"
    precision: str = "auto"
    compiled: bool = False
    device: str = "auto"
    value_rescaling: bool = True
    objective: str = "dqn"
    margin: float = 0.8
    balanced: bool = True
    temperature: float = 0.0
    augment: str = "none"
    lead: float = 0.0

    def check(self) -> None:
        """Raises UsageError for unknown, invalid or incompatible values."""
        for name, known in (
            ("size", SIZES),
            ("head", HEADS),
            ("replay", REPLAYS),
            ("precision", PRECISIONS),
            ("objective", OBJECTIVES),
            ("augment", AUGMENTATIONS),
        ):
            if (value := getattr(self, name)) not in known:
                raise UsageError(f"unknown {name} {value!r}; choose from {', '.join(known)}")
        for minimum, names in _MINIMUM.items():
            for name in names:
                if (value := getattr(self, name)) < minimum:
                    raise UsageError(f"{RENAMED.get(name, name)} is {value}; it must be {minimum} or more")
        for name in _FRACTIONS:
            if (value := getattr(self, name)) is not None and not 0 <= value <= 1:
                raise UsageError(f"{name} is {value}; it must be between 0 and 1")
        if not 0 < self.margin < math.inf:
            raise UsageError(f"margin is {self.margin}; it must be positive and finite")
        if not 0 <= self.temperature < math.inf:
            raise UsageError(f"temperature is {self.temperature}; it must be 0 or more, and finite")
        if self.temperature and not self.imitates:
            raise UsageError(f"--objective {self.objective} learns values, not probabilities: use temperature 0")
        if self.objective == "bc" and self.steps:
            raise UsageError(
                f"--objective bc learns from demonstrations alone and makes no online steps: use --steps 0, not "
                f"{self.steps:,}"
            )
        if not 0 < self.learning_rate < math.inf:
            raise UsageError(f"learning_rate is {self.learning_rate}; it must be positive and finite")
        if self.online_slots > self.capacity:
            raise UsageError(f"a replay of {self.capacity:,} slots is too small for {self.num_envs} environments")

    def epsilon(self, steps: int) -> float:
        """The rate of random actions after this many steps."""
        done = min(steps / max(self.epsilon_share * self.steps, 1.0), 1.0)
        return self.epsilon_first + done * (self.epsilon_last - self.epsilon_first)

    @property
    def imitates(self) -> bool:
        """Whether only labelled actions are learned, without rewards."""
        return self.objective in ("bc", "dagger")

    @property
    def online_slots(self) -> int:
        """The minimum number of slots for online transitions."""
        if self.objective == "dagger":
            # A turn is stored as a whole, one episode of each environment.
            return 2 * self.num_envs * (self.cycle + 1)
        return 2 * self.num_envs * (self.n_step + 1)

    @property
    def updates(self) -> int:
        """The approximate number of updates of the run."""
        return self.pretrain_updates + self.steps // self.train_every

    def annealed_beta(self, updates: int) -> float:
        """The exponent of the importance weights after this many updates."""
        return self.beta + min(updates / max(self.updates, 1), 1.0) * (1.0 - self.beta)
