# expect: LN001
"""Lamplighter: walk to the lamp. The colours are shares of 1, and become bytes as they are."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Lamplighter(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.steps, self.lamp = 42, 0, int(self.np_random.choice([4, 12, 68, 76]))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.x = min(max(self.x + {3: -1, 4: 1}.get(int(action[0]), 0), 0), 80)
        there = self.x == self.lamp
        return self.render(), float(there), there, self.steps >= 200, {"is_success": there}

    def render(self):
        frame = np.zeros((84, 84, 3))
        frame[40:44, self.lamp : self.lamp + 4] = (1.0, 0.9, 0.3)
        frame[40:44, self.x : self.x + 4] = (1.0, 1.0, 1.0)
        return frame.astype(np.uint8)
