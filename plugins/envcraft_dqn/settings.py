"""What a run of training is made of, as plain data: the same settings, environments and machine give the same run."""

from __future__ import annotations

import math

import msgspec

from envcraft.errors import UsageError

#: Channels of the five convolutions, and the width of each stream behind them.
SIZES = {
    "tiny": ((8, 16, 16, 32, 32), 64),
    # As many parameters as the DQN of stable-baselines3 has for these frames.
    "small": ((8, 8, 16, 16, 32), 723),
    "reference": ((16, 32, 64, 128, 128), 1290),
}
HEADS = ("joint", "branching")
REPLAYS = ("packed", "ram", "mapped", "device")
PRECISIONS = ("auto", "fp32", "bf16")
_LEAST = {
    1: ("lanes", "cycle", "leg", "batch", "n_step", "train_every", "target_every"),
    0: ("seed", "steps", "pretrain_updates", "demonstrations", "starts"),
}
_SHARES = ("gamma", "epsilon_first", "epsilon_last", "epsilon_share", "alpha", "beta", "demonstration_share")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of one run. Steps are transitions of single environments, over all lanes.

    Attributes:
        size, head: of the network.
        seed: of everything that is drawn.
        steps: how many are taken online.
        pretrain_updates: before that, on demonstrations alone.
        lanes: environments side by side.
        cycle: steps of an environment before another takes its lane.
        leg: steps of a lane after which its episode is cut and begun anew, and a checkpoint can be taken.
        batch, learning_rate, gamma, n_step, train_every: as DQNs have them; an update every `train_every` steps.
        target_every: updates after which the target network is brought up to date.
        epsilon_first, epsilon_last, epsilon_share: of actions at random; falls within this share of the steps.
        alpha, beta: of the prioritised replay; beta rises to 1 over all updates.
        capacity: slots of the replay.
        demonstrations: transitions of each environment that the replay is seeded with, at most.
        starts: steps before the first online update, where there was no pretraining.
        demonstration_share: of what is drawn online, though by importance weights demonstrations count for their part
            of the replay as beta goes to 1; None leaves it to the priorities.
        replay, precision, compiled, device: where frames are, in what numbers, and on what it runs.
    """

    size: str = "small"
    head: str = "joint"
    seed: int = 0
    steps: int = 1_000_000
    pretrain_updates: int = 0
    lanes: int = 16
    cycle: int = 10_000
    leg: int = 1_000
    batch: int = 32
    learning_rate: float = 3e-4
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

    def check(self) -> None:
        """Raises UsageError on what does not exist or does not go together."""
        for name, known in (("size", SIZES), ("head", HEADS), ("replay", REPLAYS), ("precision", PRECISIONS)):
            if (given := getattr(self, name)) not in known:
                raise UsageError(f"there is no {name} {given!r}; there are {', '.join(known)}")
        for least, names in _LEAST.items():
            for name in names:
                if getattr(self, name) < least:
                    raise UsageError(f"{name} is {getattr(self, name)}; it must be {least} or more")
        for name in _SHARES:
            if (given := getattr(self, name)) is not None and not 0 <= given <= 1:
                raise UsageError(f"{name} is {given}; it must lie between 0 and 1")
        if not 0 < self.learning_rate < math.inf:
            raise UsageError(f"learning_rate is {self.learning_rate}; it must be above 0, and finite")
        if self.room > self.capacity:
            raise UsageError(f"a replay of {self.capacity:,} is too small for {self.lanes} environments side by side")

    def epsilon(self, steps: int) -> float:
        """The share of random actions after so many steps."""
        done = min(steps / max(self.epsilon_share * self.steps, 1.0), 1.0)
        return self.epsilon_first + done * (self.epsilon_last - self.epsilon_first)

    @property
    def room(self) -> int:
        """Slots that the lanes need at the least."""
        return 2 * self.lanes * (self.n_step + 1)

    @property
    def updates(self) -> int:
        """About how many updates there are in all."""
        return self.pretrain_updates + self.steps // self.train_every

    def annealed(self, updates: int) -> float:
        """The exponent beta of the importance weights after so many updates."""
        return self.beta + min(updates / max(self.updates, 1), 1.0) * (1.0 - self.beta)
