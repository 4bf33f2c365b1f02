"""Two lamps are on or off, and each button has to be held exactly while its lamp is on: eight steps, +1 for each one
that is right. The episode is truncated, never terminated.
"""

import gymnasium
import numpy as np


class Lamps(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode=None):
        self.observation_space = gymnasium.spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lamps = self.np_random.integers(2, size=2)
        return self.render(), {}

    def step(self, action):
        right = float((action[1:] == self.lamps).all())
        self.steps += 1
        self.lamps = self.np_random.integers(2, size=2)
        return self.render(), right, False, self.steps == 8, {}

    def render(self):
        frame = np.full((84, 84, 3), (30, 20, 20), np.uint8)
        for side, lamp in enumerate(self.lamps):
            frame[20:60, 8 + 40 * side : 36 + 40 * side] = (250, 240, 120) if lamp else (60, 60, 70)
        return frame
