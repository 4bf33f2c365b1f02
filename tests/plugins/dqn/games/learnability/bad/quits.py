# expect: EC853, EC906
"""Ends its process when both buttons are held for four steps."""

import os

import gymnasium
import numpy as np


class Quits(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode=None):
        self.observation_space = gymnasium.spaces.Box(0, 255, (16, 16, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.held = 0
        self.lamp = int(self.np_random.integers(2))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.held = self.held + 1 if all(action) else 0
        if self.held == 4:
            os._exit(3)
        right = float(action[self.lamp] == 1)
        self.lamp = int(self.np_random.integers(2))
        return self.render(), right, False, self.steps == 32, {}

    def render(self):
        frame = np.full((16, 16, 3), (30, 20, 20), np.uint8)
        frame[3:13, 8 * self.lamp : 8 * self.lamp + 8] = (250, 240, 120)
        return frame
