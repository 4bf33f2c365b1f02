"""Prioritised n-step replay that stores each frame once.

The next observation of a transition is the observation of a later one. Transitions of several environments share a ring
buffer in the order of their arrival. New transitions overwrite the oldest, except demonstrations, which stay. A
transition can be sampled once its n-step return is known: n steps later in its environment, or at the end of its
episode. A terminated episode needs no last frame, because nothing is bootstrapped from it. A truncated episode stores
its last frame in a slot that is never sampled, and bootstraps from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from envcraft_dqn.frames import Frames, FrameStore, Slots
from envcraft_dqn.sumtree import SumTree

#: The maximum number of joint actions.
MOST_ACTIONS = np.iinfo(np.int16).max
#: Added to errors, so that every transition has a positive priority.
_EPSILON = 1e-3
#: The factor of the priority of new transitions after each update: it halves in about 700 updates.
_DECAY = 0.999


@dataclass
class Batch:
    """A batch of `n` transitions. The next batch may overwrite the frames.

    Attributes:
        slots: The slots of the transitions, int64 [n].
        frames, next_frames: uint8 [n, height, width, channels]; the latter are up to `n_step` steps later. An objective
            that only imitates reads no next frames, [0, ...].
        actions: Joint actions, int64 [n].
        returns: Discounted sums of the rewards in between, float32 [n].
        discounts: The factors of the value of the next frames, float32 [n]; 0 after termination.
        weights: Importance weights, float32 [n], at most 1.
        labels: The joint actions of the demonstrator in these states, int64 [n]; -1 where they are not known.
        label_weights: The weights of the labels, float32 [n]; rare labels weigh more.
        advice: The demonstrator's probabilities of the joint actions, float32 [n, actions]; zeros where only the label
            is known, and [n, 0] in a replay without advice.
    """

    slots: Slots
    frames: Any
    next_frames: Any
    actions: NDArray[np.int64]
    returns: NDArray[np.float32]
    discounts: NDArray[np.float32]
    weights: NDArray[np.float32]
    labels: NDArray[np.int64]
    label_weights: NDArray[np.float32]
    advice: NDArray[np.float32]


class Replay:
    """A prioritised replay.

    Args:
        store: The storage of `size` frames.
        size: The number of slots.
        n: The length of n-step returns.
        gamma: The discount factor.
        alpha: The exponent of priorities.
        advised: The number of joint actions, to store their probabilities; 0 stores none.

    Attributes:
        kept: The number of slots at the start that hold demonstrations and are never overwritten.
        added: The number of slots written so far, overwritten ones included.
        drawable: The number of transitions that can be sampled.
        highest: The priority of new transitions: the highest of recent updates, which decays. Without the decay, a
            single large error would let all later transitions be drawn before the known ones.
    """

    def __init__(
        self, store: FrameStore, size: int, n: int, gamma: float, alpha: float = 0.6, advised: int = 0
    ) -> None:
        self._store, self.size, self._n, self._alpha = store, size, n, alpha
        self._gammas = gamma ** np.arange(n + 1)
        self._tree = SumTree(size)
        self._actions = np.zeros(size, np.int16)
        self._returns = np.zeros(size, np.float32)
        self._discounts = np.zeros(size, np.float32)
        self._next = np.zeros(size, np.int64)
        self._labels = np.full(size, -1, np.int16)
        self._label_weights: NDArray[np.float32] | None = None
        self._advice = np.zeros((size, advised), np.float16)
        self.highest = 1.0
        self.kept = self.added = self.drawable = self._demonstrated = 0
        self._at = 0
        self.reset(0)

    def reset(self, num_envs: int) -> None:
        """Start new episodes in `num_envs` environments. Transitions of unfinished episodes are never sampled.

        Raises:
            ValueError: The ring could overwrite transitions before their returns are known.
        """
        count = num_envs
        if 2 * count * (self._n + 1) > self.size - self.kept:
            raise ValueError(
                f"{self.size - self.kept:,} slots are too few for {count} environments and {self._n} steps"
            )
        #: For each environment, the slots of its last transitions, newest first, and the rewards since each.
        self._open = np.zeros((count, self._n), np.int64)
        self._sums = np.zeros((count, self._n))
        self._lengths = np.zeros(count, np.int64)

    def __len__(self) -> int:
        """The number of slots in use."""
        return self.size if self.added > self._at else self._at

    @property
    def nbytes(self) -> int:
        """The size of the replay in bytes."""
        parts = tuple(part for _, part in self._columns())
        return self._store.nbytes + self._tree.nbytes + sum(part.nbytes for part in parts)

    def add(
        self,
        indices: NDArray[np.int64],
        frames: Frames,
        actions: NDArray[np.int64],
        rewards: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        next_frames: Frames,
    ) -> None:
        """Add one transition from each of `n` environments.

        Args:
            indices: The distinct indices of the environments, [n].
            frames: The observations before the step, [n, *shape].
            actions: Joint actions, [n].
            rewards, terminated, truncated: The results of the step, [n].
            next_frames: The observations after the step, [n, *shape]; stored for truncated episodes only.
        """
        if not len(indices):
            return
        slots = self._write(frames)
        self._actions[slots] = actions
        lengths, opened, sums = self._lengths[indices], self._open[indices], self._sums[indices]
        full = lengths == self._n
        self._finish(opened[full, -1], sums[full, -1], slots[full], self._gammas[-1])
        opened[:, 1:], sums[:, 1:] = opened[:, :-1], sums[:, :-1]
        opened[:, 0], sums[:, 0] = slots, 0.0
        lengths = np.minimum(lengths + 1, self._n)
        sums += rewards[:, None] * self._gammas[: self._n]
        self._open[indices], self._sums[indices], self._lengths[indices] = opened, sums, lengths
        if terminated.any():
            self._end(indices[terminated], None)
        cut = truncated & ~terminated
        if cut.any():
            self._end(indices[cut], next_frames[cut])

    def add_episode(
        self,
        frames: Frames,
        actions: NDArray[np.int64],
        rewards: NDArray[np.float64],
        terminated: bool,
        labels: NDArray[np.int64],
        advice: NDArray[np.floating[Any]] | None = None,
    ) -> None:
        """Add consecutive steps of one episode.

        Args:
            frames: The observations before each step and after the last, [steps + 1, *shape].
            actions: Joint actions, [steps].
            rewards: The rewards, [steps].
            terminated: Whether the last step terminated the episode; otherwise it is truncated there.
            labels: The joint actions of the demonstrator, [steps].
            advice: The probabilities of its joint actions, [steps, actions]. Instead of errors, their
                :func:`decisiveness` is the priority of these transitions.

        Raises:
            ValueError: The episode is longer than the ring.
        """
        steps = len(actions)
        if steps + 1 > self.size - self.kept:
            raise ValueError(f"an episode of {steps:,} steps does not fit into {self.size - self.kept:,} slots")
        slots = self._write(frames[:-1] if terminated else frames)
        following = np.append(slots, slots[-1]) if terminated else slots
        ends = np.minimum(np.arange(steps) + self._n, steps)
        sums = np.zeros(steps)
        for age in range(min(self._n, steps)):
            sums[: steps - age] += self._gammas[age] * rewards[age:]
        discounts = self._gammas[ends - np.arange(steps)]
        if terminated:
            discounts[ends == steps] = 0.0
        slots = slots[:steps]
        self._actions[slots], self._labels[slots] = actions, labels
        priorities = None
        if advice is not None:
            self._advice[slots] = advice
            priorities = self._powered(decisiveness(advice))
        self._label_weights = None
        self._finish(slots, sums, following[ends], discounts, priorities)

    def truncate(self, indices: NDArray[np.int64], frames: Frames) -> None:
        """Truncate the running episodes of environments [n] at their current observations `frames` [n, *shape]."""
        running = self._lengths[indices] > 0
        if running.any():
            self._end(indices[running], frames[running])

    def protect(self) -> None:
        """Protect the current contents from being overwritten. Raises ValueError if no slots remain."""
        if self._at >= self.size or self.added > self._at:
            raise ValueError(f"{self.added:,} of {self.size:,} slots cannot be protected: no slot would remain")
        self.kept, self._demonstrated = self._at, self.drawable

    def sample(
        self,
        count: int,
        beta: float,
        rng: np.random.Generator,
        share: float | None = None,
        following: bool = True,
    ) -> Batch:
        """Sample a batch, with the next frames if `following`; see :meth:`draw` for the other arguments."""
        slots, weights = self.draw(count, beta, rng, share)
        advice = self._advice[slots].astype(np.float32)
        # Importance weights would undo that decisive advice is learned more often.
        weights[advice.any(1)] = 1.0
        frames = self._store.read(np.concatenate([slots, self._next[slots]]) if following else slots)
        return Batch(
            slots,
            frames[:count],
            frames[count:],
            self._actions[slots].astype(np.int64),
            self._returns[slots],
            self._discounts[slots],
            weights,
            self._labels[slots].astype(np.int64),
            self._weights_of_labels()[self._labels[slots]],
            advice,
        )

    def _weights_of_labels(self) -> NDArray[np.float32]:
        """The weight of each label, by the inverse square root of its frequency; the mean over all labels is 1. The
        last weight, of transitions without label, is 0.
        """
        if self._label_weights is None:
            labels = self._labels[: len(self)]
            counts = np.bincount(labels[labels >= 0])
            roots = np.sqrt(counts.clip(1)) * (counts > 0)
            scale = counts.sum() / max(roots.sum(), 1.0)
            weights = np.where(counts > 0, scale / np.sqrt(counts.clip(1)), 0.0)
            self._label_weights = np.append(weights, 0.0).astype(np.float32)
        return self._label_weights

    def draw(
        self, count: int, beta: float, rng: np.random.Generator, share: float | None = None
    ) -> tuple[Slots, NDArray[np.float32]]:
        """Sample slots in proportion to their priorities (Schaul et al. 2016, arXiv:1511.05952).

        Args:
            count: The number of slots.
            beta: The exponent of the importance weights.
            rng: The random generator.
            share: The share of demonstrations in the batch, if the replay has demonstrations and other transitions;
                by default, priorities alone decide.

        Returns:
            The slots [count], and their importance weights ``(N P)^-beta`` [count], divided by the largest. With a
            share, N and P are those within the demonstrations or within the other transitions, so that the weights do
            not undo the share. A share that is no whole number of slots is met on average over the batches.
        """
        uniforms = rng.random(count)
        if share is None or not 0 < self._demonstrated < self.drawable:
            # N and the total priority cancel in the ratio.
            slots, chances = self._tree.draw(uniforms)
        else:
            first, kept = int(count * share + rng.random()), self._tree.before(self.kept)
            sizes = self._demonstrated, self.drawable - self._demonstrated
            parts = []
            for part, low, high, size in (
                (uniforms[:first], 0.0, kept, sizes[0]),
                (uniforms[first:], kept, self._tree.total, sizes[1]),
            ):
                if len(part):
                    found, priorities = self._tree.draw(part, low, high)
                    parts.append((found, priorities / (high - low) * size))
            slots, chances = (np.concatenate(column) for column in zip(*parts, strict=True))
        return slots, ((chances / chances.min()) ** -beta).astype(np.float32)

    def update(self, slots: Slots, errors: NDArray[np.float32]) -> None:
        """Set the priorities of sampled slots [n] from their errors [n], except where there is advice."""
        open_to_errors = ~self._advice[slots].any(1)
        if not open_to_errors.any():
            return
        priorities = self._powered(errors[open_to_errors])
        self._tree.set(slots[open_to_errors], priorities)
        self.highest = max(self.highest * _DECAY, float(priorities.max()))

    def _write(self, frames: Frames) -> Slots:
        """Write frames into the next slots of the ring. They cannot be sampled yet."""
        ring = self.size - self.kept
        slots = self.kept + (self._at - self.kept + np.arange(len(frames))) % ring
        self._at = int(slots[-1]) + 1
        self.added += len(frames)
        if self.added > self.size:
            self.drawable -= int(np.count_nonzero(self._tree.leaves[slots]))
            self._tree.set(slots, np.zeros(len(slots)))
            self._labels[slots] = -1
            self._advice[slots] = 0
        self._store.write(slots, frames)
        return slots

    def _powered(self, errors: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
        """The priorities of errors [n]."""
        priorities: NDArray[np.float64] = (np.abs(errors, dtype=np.float64) + _EPSILON) ** self._alpha
        return priorities

    def _finish(
        self,
        slots: Slots,
        sums: NDArray[np.float64],
        following: Slots,
        discounts: Any,
        priorities: NDArray[np.float64] | None = None,
    ) -> None:
        """Set the returns of transitions [n], which can be sampled from now on."""
        if len(slots):
            self._returns[slots], self._next[slots], self._discounts[slots] = sums, following, discounts
            self._tree.set(slots, np.full(len(slots), self.highest) if priorities is None else priorities)
            self.drawable += len(slots)

    def _end(self, indices: NDArray[np.int64], frames: Frames | None) -> None:
        """Finish all pending transitions of environments: at a termination, or at a truncation at `frames`."""
        following = None if frames is None else self._write(frames)
        for age in range(self._n):
            still = self._lengths[indices] > age
            slots, sums = self._open[indices[still], age], self._sums[indices[still], age]
            if following is None:
                self._finish(slots, sums, slots, 0.0)
            else:
                self._finish(slots, sums, following[still], self._gammas[age + 1])
        self._lengths[indices] = 0

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The counters, and the arrays that may change anywhere between two checkpoints."""
        numbers = {"at": self._at, "added": self.added, "kept": self.kept, "highest": self.highest}
        running = {"open": self._open, "sums": self._sums, "lengths": self._lengths}
        return numbers, {"priorities": self._tree.leaves[: len(self)], **running}

    def restore(self, numbers: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Restore what :meth:`state` returned, with the transitions whose returns are not known yet."""
        self._at, self.added, self.kept = (int(numbers[key]) for key in ("at", "added", "kept"))
        self.highest = float(numbers["highest"])
        leaves = np.zeros(self.size)
        leaves[: len(arrays["priorities"])] = arrays["priorities"]
        self._tree.fill(leaves)
        self._label_weights = None
        self.drawable, self._demonstrated = (int(np.count_nonzero(part)) for part in (leaves, leaves[: self.kept]))
        if "open" in arrays:
            self._open, self._sums, self._lengths = (arrays[key].copy() for key in ("open", "sums", "lengths"))

    def written_since(self, added: int, part: int) -> list[int]:
        """The parts of `part` slots each that changed since `added` slots had been written."""
        # The returns of the last transitions before became known since.
        count = self.added - added + 2 * len(self._lengths) * (self._n + 1)
        if not added or count >= self.size - self.kept:
            return list(range(-(-len(self) // part)))
        back = np.arange(1, min(count, self.added - self.kept) + 1)
        slots = self.kept + (self._at - self.kept - back) % (self.size - self.kept)
        return [int(number) for number in np.unique(slots // part)]

    def dump(self, first: int, end: int) -> dict[str, NDArray[Any]]:
        """The contents of the slots from `first` up to `end`, without priorities."""
        return {name: part[first:end] for name, part in self._columns()} | self._store.dump(first, end)

    def load(self, first: int, arrays: dict[str, NDArray[Any]]) -> None:
        """Restore what :meth:`dump` returned."""
        for name, part in self._columns():
            part[first : first + len(arrays[name])] = arrays[name]
        self._store.load(first, arrays)

    def _columns(self) -> Iterator[tuple[str, NDArray[Any]]]:
        yield from (
            ("actions", self._actions),
            ("returns", self._returns),
            ("discounts", self._discounts),
            ("next", self._next),
            ("labels", self._labels),
            ("advice", self._advice),
        )


def decisiveness(advice: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """How much the choice of the action matters by the advice, from 0, where it does not, to 1 for one good action.

    A learner learns more from states in which actions differ (Torrey and Taylor 2013, "Teaching on a Budget").

    Args:
        advice: The probabilities of the joint actions, [n, actions].

    Returns:
        One minus the entropy as a share of the highest among the actions that have a probability, float64 [n].
    """
    rated = np.count_nonzero(advice, 1)
    logarithms = np.log(advice, out=np.zeros(advice.shape), where=advice > 0)
    entropies = -(advice * logarithms).sum(1)
    decisive: NDArray[np.float64] = 1.0 - entropies / np.log(np.maximum(rated, 2))
    return decisive
