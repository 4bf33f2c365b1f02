"""The family `doors`: corridors with a door at each end; the lit door is the right one."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

from envcraft.environments.families import Family, Generated

_SOURCE = '''\
"""Doors: a corridor of {length} pixels with two doors; behind the lit one it goes on."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Doors(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.steps = {start}, 0
        self.lit = int(self.np_random.choice([0, {length}]))
        return self.render(), {{}}

    def step(self, action):
        self.steps += 1
        if 0 < self.x < {length}:
            self.x += {{3: -1, 4: 1}}.get(int(action[0]), 0)
        through, right = self.x in (0, {length}), self.x == self.lit
        reward = (1.0 if right else -1.0) if through else 0.0
        return self.render(), reward, through, self.steps >= 300, {{"is_success": right}}

    def render(self):
        frame = np.full((84, 84, 3), 30, np.uint8)
        frame[30:54, [0, {length}]] = 90
        frame[30:54, self.lit] = 255
        frame[40:44, self.x] = (240, 200, 80)
        return frame
'''


class DoorsFamily(Family):
    name = "doors"
    summary = "a corridor of some length, with a lit door at one end"

    def generate(self, count: int, seed: int, difficulty: float | None = None) -> Iterator[Generated]:
        rng = Random(seed)
        for number in range(count):
            length = rng.randint(20, 83)
            start = rng.randint(length // 3, length - length // 3)
            source = _SOURCE.format(length=length, start=start)
            yield Generated(f"doors_{seed}_{number:03}", source, {"length": length, "start": start})
