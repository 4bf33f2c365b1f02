# expect: LN001
"""Moth: fly to the light. The frame holds the numbers of the colours in place of the colours."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

PALETTE = [(0, 0, 0), (90, 90, 110), (255, 220, 120), (255, 255, 255)]


class Moth(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.y, self.steps, self.light = 42, 0, int(self.np_random.choice([4, 12, 68, 76]))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.y = min(max(self.y + {1: -1, 2: 1}.get(int(action[0]), 0), 0), 80)
        there = self.y == self.light
        return self.render(), float(there), there, self.steps >= 200, {"is_success": there}

    def render(self):
        picture = np.ones((84, 84), np.uint8)
        picture[self.light, 30:50] = 2
        picture[self.y : self.y + 3, 38:42] = 3
        return np.repeat(picture[:, :, None], 3, axis=2)
