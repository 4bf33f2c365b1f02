"""Where actions come from: players that need no look at the environment, drawn from the checker's own generator.

The lists depend on the action space, the seed and the length only, so that the same ``--seed`` gives the same episodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from envcraft import spaces

Action = Any


def random_actions(space: spaces.Space, seed: int, length: int) -> list[Action]:
    """Uniformly random at each step."""
    rng = np.random.default_rng([seed, 1])
    if space["type"] == "MultiDiscrete" and np.ndim(space["nvec"]) == 1:
        start = np.asarray(space.get("start", 0))
        drawn: list[Action] = (rng.integers(0, space["nvec"], (length, len(space["nvec"]))) + start).tolist()
        # An action is the same object wherever it is drawn again: an episode of a thousand holds twenty.
        shared: dict[tuple[int, ...], Action] = {}
        return [shared.setdefault(tuple(action), action) for action in drawn]
    return [spaces.sample(space, rng) for _ in range(length)]


def sticky_actions(space: spaces.Space, seed: int, length: int) -> list[Action]:
    """Random actions, each held for a random while: they travel further than uniformly random ones."""
    rng = np.random.default_rng([seed, 2])
    found: list[Action] = []
    while len(found) < length:
        found += [spaces.sample(space, rng)] * int(rng.choice([1, 2, 4, 8, 16, 32]))
    return found[:length]


def held_action(action: Action, length: int) -> list[Action]:
    """One action throughout."""
    return [action] * length


def rotation(choices: list[Action], offset: int, seed: int, length: int) -> list[Action]:
    """A shuffled order of the choices, begun at `offset`: over all offsets, every choice is made at every step."""
    rng = np.random.default_rng([seed, 3])
    rounds = -(-length // len(choices))
    order = np.concatenate([rng.permutation(len(choices)) for _ in range(rounds)])
    return [choices[(int(order[step]) + offset) % len(choices)] for step in range(length)]
