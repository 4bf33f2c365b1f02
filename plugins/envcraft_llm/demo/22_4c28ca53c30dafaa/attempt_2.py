"""Radio Station: bring the sound engineer to the antenna."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 6
MAX_STEPS = 200
WAYS = {0: (0, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.engineer = [0, int(self.np_random.integers(14))]
        self.antenna = [int(self.np_random.integers(8, 14)), int(self.np_random.integers(14))]
        return self.render(), {"is_success": False}

    def step(self, action):
        self.steps += 1
        won = self.engineer == self.antenna
        if not won:
            dc, dr = WAYS[int(action[0])]
            self.engineer = [min(max(self.engineer[0] + dc, 0), 13), min(max(self.engineer[1] + dr, 0), 13)]
            won = self.engineer == self.antenna
        truncated = self.steps >= MAX_STEPS and not won
        return self.render(), 1.0 if won else 0.0, won, truncated, {"is_success": won}

    def render(self):
        img = np.zeros((84, 84, 3), np.uint8)
        for (c, r), ink in ((self.antenna, (214, 200, 160)), (self.engineer, (250, 160, 60))):
            img[r * CELL : r * CELL + CELL, c * CELL : c * CELL + CELL] = ink
        return img
