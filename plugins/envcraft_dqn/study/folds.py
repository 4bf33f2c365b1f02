"""Which environments an agent is trained on, and which it is tested on: every one of them is tested once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import msgspec
import numpy as np

from envcraft.errors import UsageError

_T = TypeVar("_T")


class Split(msgspec.Struct, frozen=True):
    """One fold is held out (`test`), the others are what is trained on (`train`); both in the order of the names."""

    number: int
    train: tuple[str, ...]
    test: tuple[str, ...]


def splits(names: Sequence[str], folds: int, seed: int) -> list[Split]:
    """A random partition into `folds` parts, which differ by one in size at the most; each is held out in turn.

    Raises UsageError where there are fewer environments than folds, fewer than two folds, or a name twice.
    """
    if folds < 2:
        raise UsageError(f"{folds} folds leave nothing to train on: take 2 or more")
    if len(names) < folds:
        raise UsageError(f"{len(names)} environments cannot be parted into {folds} folds: take fewer --folds")
    if len(set(names)) < len(names):
        raise UsageError("an environment is there twice: it would be trained on and tested")
    order = _shuffled(sorted(names), [seed, 10])
    found = []
    for number in range(folds):
        held = set(order[number::folds])
        train = tuple(name for name in sorted(names) if name not in held)
        found.append(Split(number, train, tuple(sorted(held))))
    return found


def subset(split: Split, size: int, seed: int) -> tuple[str, ...]:
    """So many of the environments that a split trains on; smaller subsets are contained in larger ones.

    Raises UsageError where there are not as many.
    """
    if not 1 <= size <= len(split.train):
        raise UsageError(f"a subset of {size} cannot be taken of the {len(split.train)} that a split trains on")
    return tuple(sorted(_shuffled(split.train, [seed, 11, split.number])[:size]))


def sample(split: Split, size: int, seed: int) -> tuple[str, ...]:
    """So many of the environments that a split trains on, or all of them, for the agent to be tested on, too."""
    return tuple(sorted(_shuffled(split.train, [seed, 12, split.number])[:size]))


def _shuffled(names: Sequence[_T], seed: Sequence[int]) -> list[_T]:
    return [names[place] for place in np.random.default_rng(seed).permutation(len(names))]
