# expect: EC851
"""Pays only after sixteen right steps in a row, which nobody comes upon."""

import gymnasium
import numpy as np


class SecretCode(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode=None):
        self.observation_space = gymnasium.spaces.Box(0, 255, (16, 16, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.right = 0
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        wanted = (self.steps // 2 % 2, self.steps // 3 % 2)
        self.right = self.right + 1 if tuple(action) == wanted else 0
        return self.render(), float(self.right == 16), False, self.steps == 32, {}

    def render(self):
        frame = np.full((16, 16, 3), (30, 20, 20), np.uint8)
        frame[:2, : self.steps // 2] = 200
        return frame
