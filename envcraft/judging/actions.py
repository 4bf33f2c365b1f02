"""Players that do not look at the environment. They draw actions from the checker's own generator.

The lists depend on the action space, the seed and the length only, so that the same ``--seed`` gives the same episodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from envcraft.spaces.sampling import sample
from envcraft.spaces.spec import MultiDiscrete, SpaceSpec

Action = Any


def random_actions(space: SpaceSpec, seed: int, length: int) -> list[Action]:
    """Uniformly random at each step."""
    rng = np.random.default_rng([seed, 1])
    if isinstance(space, MultiDiscrete) and space.limits[0].ndim == 1:
        nvec, start = space.limits
        drawn: list[Action] = (rng.integers(0, nvec, (length, len(nvec))) + start).tolist()
        # An action is the same object wherever it is drawn again: an episode of a thousand holds twenty.
        shared: dict[tuple[int, ...], Action] = {}
        return [shared.setdefault(tuple(action), action) for action in drawn]
    return [sample(space, rng) for _ in range(length)]


def sticky_actions(space: SpaceSpec, seed: int, length: int) -> list[Action]:
    """Random actions, each held for a random while: they travel further than uniformly random ones."""
    rng = np.random.default_rng([seed, 2])
    found: list[Action] = []
    while len(found) < length:
        found += [sample(space, rng)] * int(rng.choice([1, 2, 4, 8, 16, 32]))
    return found[:length]


def held_action(action: Action, length: int) -> list[Action]:
    """One action throughout."""
    return [action] * length


def rotation(choices: list[Action], offset: int, seed: int, length: int) -> list[Action]:
    """A shuffled order of the choices that starts at `offset`. Over all offsets, every step has every choice."""
    rng = np.random.default_rng([seed, 3])
    rounds = -(-length // len(choices))
    order = np.concatenate([rng.permutation(len(choices)) for _ in range(rounds)])
    return [choices[(int(order[step]) + offset) % len(choices)] for step in range(length)]
