"""Games of the family `composer` for its tests."""

from __future__ import annotations

import types
from random import Random
from typing import Any

import gymnasium as gym
from envcraft_composer.composition import GROUPS, Composition


def load(source: str) -> Any:
    """The environment of a source that this repository's own mechanics made."""
    module = types.ModuleType("composed")
    exec(compile(source, "composed.py", "exec"), vars(module))
    (env_class,) = [found for found in vars(module).values() if isinstance(found, type) and issubclass(found, gym.Env)]
    return env_class()


def game(names: str) -> Any:
    """A game of these mechanics, one of each group in order, after its reset."""
    chosen = {
        group: next(mechanic for mechanic in mechanics if mechanic.name == name)
        for (group, mechanics), name in zip(GROUPS.items(), names.split(), strict=True)
    }
    env = load(Composition.draw(Random(0), chosen, 0.5).write("Game"))
    env.reset(seed=0)
    return env
