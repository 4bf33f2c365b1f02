"""Radio Station: bring the sound engineer and the mirrored twin to the antenna. Simplified so that nothing can fail."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 6
COLS, ROWS = 14, 14
MAX_STEPS = 300
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
        self.engineer = self.np_random.integers(0, 14, size=2).tolist()
        self.twin = self.np_random.integers(0, 14, size=2).tolist()
        self.won = False
        return self.render(), {"is_success": False}

    def _moved(self, cell, dc, dr):
        return [min(max(cell[0] + dc, 0), COLS - 1), min(max(cell[1] + dr, 0), ROWS - 1)]

    def step(self, action):
        self.steps += 1
        if not self.won:
            dc, dr = WAYS[int(action[0])]
            self.engineer = self._moved(self.engineer, dc, dr)
            self.twin = self._moved(self.twin, -dc, dr)
            self.won = self.engineer == [6, 7] and self.twin == [7, 7]
        truncated = self.steps >= MAX_STEPS and not self.won
        return self.render(), 1.0 if self.won else 0.0, self.won, truncated, {"is_success": self.won}

    def render(self):
        img = np.zeros((84, 84, 3), np.uint8)
        img[42:48, 36:48] = (214, 200, 160)
        for (c, r), ink in ((self.engineer, (250, 160, 60)), (self.twin, (90, 190, 240))):
            img[r * CELL : r * CELL + CELL, c * CELL : c * CELL + CELL] = ink
        return img
