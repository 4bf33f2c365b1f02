"""Cross-validation folds over environments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import msgspec
import numpy as np

from envcraft.errors import UsageError

_T = TypeVar("_T")


class Split(msgspec.Struct, frozen=True):
    """The environments for training and the held-out fold for testing, both sorted by name."""

    number: int
    train: tuple[str, ...]
    test: tuple[str, ...]


def splits(names: Sequence[str], folds: int, seed: int) -> list[Split]:
    """Partition environments at random into folds whose sizes differ by at most one, and hold each out in turn.

    Args:
        names: The distinct names of the environments.
        folds: The number of folds, at least two.
        seed: The seed of the partition.

    Raises:
        UsageError: There are fewer than two folds, fewer environments than folds, or repeated names.
    """
    if folds < 2:
        raise UsageError(f"{folds} folds leave no environments for training: use 2 or more")
    if len(names) < folds:
        raise UsageError(f"{len(names)} environments cannot be split into {folds} folds: use fewer --folds")
    if len(set(names)) < len(names):
        raise UsageError("an environment occurs twice, which would put it into training and test")
    order = _shuffled(sorted(names), [seed, 10])
    found = []
    for number in range(folds):
        held = set(order[number::folds])
        train = tuple(name for name in sorted(names) if name not in held)
        found.append(Split(number, train, tuple(sorted(held))))
    return found


def subset(split: Split, size: int, seed: int) -> tuple[str, ...]:
    """A random subset of the training environments of a split. Smaller subsets are contained in larger ones.

    Raises:
        UsageError: The split has fewer training environments.
    """
    if not 1 <= size <= len(split.train):
        raise UsageError(f"a subset of {size} is not possible: a split trains on {len(split.train)} environments")
    return tuple(sorted(_shuffled(split.train, [seed, 11, split.number])[:size]))


def sample(split: Split, size: int, seed: int) -> tuple[str, ...]:
    """A random sample of at most `size` training environments of a split, for tests in familiar environments."""
    return tuple(sorted(_shuffled(split.train, [seed, 12, split.number])[:size]))


def _shuffled(names: Sequence[_T], seed: Sequence[int]) -> list[_T]:
    return [names[place] for place in np.random.default_rng(seed).permutation(len(names))]
