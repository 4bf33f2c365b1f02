"""Prioritised n-step replay whose frames are stored once: the next observation of a transition is another's first.

Transitions come from several lanes, environments that are stepped side by side, and lie in a ring in the order in which
they came; the oldest are overwritten, but for demonstrations, which stay. A transition can be drawn once its n-step
return is known: at the transition n steps later in its lane, or at the end of its episode. A terminated episode needs
no last frame, since nothing is bootstrapped from it; a truncated one keeps it in a slot of its own that is never drawn,
and bootstraps from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_dqn.frames import Frames, FrameStore, Slots
from envcraft_dqn.sumtree import SumTree

#: Joint actions that can be told apart.
MOST_ACTIONS = np.iinfo(np.int16).max
#: Added to errors, so that every transition is drawn at times.
_LEAST = 1e-3


@dataclass
class Batch:
    """`n` transitions; frames are as the store gives them, and may be overwritten by the next batch.

    Attributes:
        slots: where they are, int64 [n].
        frames, next_frames: uint8 [n, height, width, 3], the latter up to n steps later.
        actions: joint actions, int64 [n].
        returns: discounted sums of the rewards in between, float32 [n].
        discounts: of the value of the next frames, float32 [n]; 0 after termination.
        weights: importance weights, float32 [n], at most 1.
    """

    slots: Slots
    frames: Any
    next_frames: Any
    actions: NDArray[np.int64]
    returns: NDArray[np.float32]
    discounts: NDArray[np.float32]
    weights: NDArray[np.float32]


class Replay:
    """A replay of as many slots as `store` has for `size` frames.

    Attributes:
        kept: how many slots at the beginning are demonstrations and never overwritten.
        added: how many slots were ever written.
        drawable: how many transitions can be drawn.
    """

    def __init__(self, store: FrameStore, size: int, n: int, gamma: float, alpha: float = 0.6) -> None:
        self._store, self.size, self._n, self._alpha = store, size, n, alpha
        self._gammas = gamma ** np.arange(n + 1)
        self._tree = SumTree(size)
        self._actions = np.zeros(size, np.int16)
        self._returns = np.zeros(size, np.float32)
        self._discounts = np.zeros(size, np.float32)
        self._next = np.zeros(size, np.int64)
        self.highest = 1.0
        self.kept = self.added = self.drawable = self._demonstrated = 0
        self._at = 0
        self.lanes(0)

    def lanes(self, count: int) -> None:
        """Begin anew with `count` lanes. What is under way in the lanes so far and was not ended is never drawn.

        Raises ValueError where the ring could come round before a return is known.
        """
        if 2 * count * (self._n + 1) > self.size - self.kept:
            raise ValueError(f"{self.size - self.kept:,} slots are too few for {count} lanes and {self._n} steps")
        #: For each lane the slots of the last transitions, newest first, and the rewards since each.
        self._open = np.zeros((count, self._n), np.int64)
        self._sums = np.zeros((count, self._n))
        self._lengths = np.zeros(count, np.int64)

    def __len__(self) -> int:
        """Slots that hold something."""
        return self.size if self.added > self._at else self._at

    @property
    def nbytes(self) -> int:
        parts = (self._actions, self._returns, self._discounts, self._next)
        return self._store.nbytes + self._tree.nbytes + sum(part.nbytes for part in parts)

    def add(
        self,
        lanes: NDArray[np.int64],
        frames: Frames,
        actions: NDArray[np.int64],
        rewards: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        next_frames: Frames,
    ) -> None:
        """Take one transition from each of some lanes, no two of which are the same: `frames` [n, *shape], joint
        `actions` [n], what the step gave, and `next_frames`, of which only those of truncated episodes are kept.
        """
        if not len(lanes):
            return
        slots = self._write(frames)
        self._actions[slots] = actions
        lengths, opened, sums = self._lengths[lanes], self._open[lanes], self._sums[lanes]
        full = lengths == self._n
        self._settle(opened[full, -1], sums[full, -1], slots[full], self._gammas[-1])
        opened[:, 1:], sums[:, 1:] = opened[:, :-1], sums[:, :-1]
        opened[:, 0], sums[:, 0] = slots, 0.0
        lengths = np.minimum(lengths + 1, self._n)
        sums += rewards[:, None] * self._gammas[: self._n]
        self._open[lanes], self._sums[lanes], self._lengths[lanes] = opened, sums, lengths
        if terminated.any():
            self._end(lanes[terminated], None)
        cut = truncated & ~terminated
        if cut.any():
            self._end(lanes[cut], next_frames[cut])

    def cut(self, lanes: NDArray[np.int64], frames: Frames) -> None:
        """End the episodes that are under way in some lanes as if they were truncated; they stand at `frames`."""
        begun = self._lengths[lanes] > 0
        if begun.any():
            self._end(lanes[begun], frames[begun])

    def keep(self) -> None:
        """What is in the replay stays: the ring is made of what is left. Raises ValueError where nothing is."""
        if self._at >= self.size or self.added > self._at:
            raise ValueError(f"{self.added:,} slots are to be kept of {self.size:,}, and some must be left")
        self.kept, self._demonstrated = self._at, self.drawable

    def sample(self, count: int, beta: float, rng: np.random.Generator, share: float | None = None) -> Batch:
        """Draw transitions, as :meth:`draw` does, with all that belongs to them."""
        slots, weights = self.draw(count, beta, rng, share)
        frames = self._store.read(np.concatenate([slots, self._next[slots]]))
        return Batch(
            slots,
            frames[:count],
            frames[count:],
            self._actions[slots].astype(np.int64),
            self._returns[slots],
            self._discounts[slots],
            weights,
        )

    def draw(
        self, count: int, beta: float, rng: np.random.Generator, share: float | None = None
    ) -> tuple[Slots, NDArray[np.float32]]:
        """Draw slots in proportion to priorities, and give their importance weights ``(N P)^-beta`` over the largest of
        these (Schaul et al. 2016, arXiv:1511.05952). With `share` so much of the batch are demonstrations, as far as
        there are both.
        """
        uniforms = rng.random(count)
        if share is None or not 0 < self._demonstrated < self.drawable:
            # N and the sum of all priorities fall out of the ratio.
            slots, chances = self._tree.draw(uniforms)
        else:
            first, kept = round(count * share), self._tree.before(self.kept)
            parts = []
            for part, low, high in ((uniforms[:first], 0.0, kept), (uniforms[first:], kept, self._tree.total)):
                if len(part):
                    found, priorities = self._tree.draw(part, low, high)
                    parts.append((found, priorities / (high - low) * (len(part) / count)))
            slots, chances = (np.concatenate(column) for column in zip(*parts, strict=True))
        return slots, ((chances / chances.min()) ** -beta).astype(np.float32)

    def update(self, slots: Slots, errors: NDArray[np.float32]) -> None:
        """Set priorities by the absolute TD errors of transitions that were drawn."""
        priorities = (np.abs(errors, dtype=np.float64) + _LEAST) ** self._alpha
        self._tree.set(slots, priorities)
        self.highest = max(self.highest, float(priorities.max()))

    def _write(self, frames: Frames) -> Slots:
        """Write frames into the next slots of the ring; nothing in them can be drawn yet."""
        ring = self.size - self.kept
        slots = self.kept + (self._at - self.kept + np.arange(len(frames))) % ring
        self._at = int(slots[-1]) + 1
        self.added += len(frames)
        if self.added > self.size:
            self.drawable -= int(np.count_nonzero(self._tree.leaves[slots]))
            self._tree.set(slots, np.zeros(len(slots)))
        self._store.write(slots, frames)
        return slots

    def _settle(self, slots: Slots, sums: NDArray[np.float64], following: Slots, discounts: Any) -> None:
        """Returns are known: from now on these transitions can be drawn."""
        if len(slots):
            self._returns[slots], self._next[slots], self._discounts[slots] = sums, following, discounts
            self._tree.set(slots, np.full(len(slots), self.highest))
            self.drawable += len(slots)

    def _end(self, lanes: NDArray[np.int64], frames: Frames | None) -> None:
        """Settle all that is open in some lanes: before a termination, or before a cut that left them at `frames`."""
        following = None if frames is None else self._write(frames)
        for age in range(self._n):
            still = self._lengths[lanes] > age
            slots, sums = self._open[lanes[still], age], self._sums[lanes[still], age]
            if following is None:
                self._settle(slots, sums, slots, 0.0)
            else:
                self._settle(slots, sums, following[still], self._gammas[age + 1])
        self._lengths[lanes] = 0

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Numbers, and the arrays that change from one checkpoint to the next in any place."""
        numbers = {"at": self._at, "added": self.added, "kept": self.kept, "highest": self.highest}
        return numbers, {"priorities": self._tree.leaves[: len(self)]}

    def restore(self, numbers: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Take back what :meth:`state` gave, with no lane begun."""
        self._at, self.added, self.kept = (int(numbers[key]) for key in ("at", "added", "kept"))
        self.highest = float(numbers["highest"])
        leaves = np.zeros(self.size)
        leaves[: len(arrays["priorities"])] = arrays["priorities"]
        self._tree.fill(leaves)
        self.drawable, self._demonstrated = (int(np.count_nonzero(part)) for part in (leaves, leaves[: self.kept]))

    def written_since(self, added: int, part: int) -> list[int]:
        """Which parts of as many slots were written since so many had been added."""
        if not added or self.added - added >= self.size - self.kept:
            return list(range(-(-len(self) // part)))
        back = np.arange(1, self.added - added + 1)
        slots = self.kept + (self._at - self.kept - back) % (self.size - self.kept)
        return [int(number) for number in np.unique(slots // part)]

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        """All but the priorities of the slots from `first` to before `end`."""
        return {name: part[first:end] for name, part in self._columns()} | self._store.dump(first, end)

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        """Put back what :meth:`dump` gave."""
        for name, part in self._columns():
            part[first : first + len(arrays[name])] = arrays[name]
        self._store.load(first, arrays)

    def _columns(self) -> Iterator[tuple[str, NDArray[Any]]]:
        yield from (
            ("actions", self._actions),
            ("returns", self._returns),
            ("discounts", self._discounts),
            ("next", self._next),
        )
