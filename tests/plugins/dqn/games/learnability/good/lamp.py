"""The button on the side of the lamp pays."""

import gymnasium
import numpy as np


class Lamp(gymnasium.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode=None):
        self.observation_space = gymnasium.spaces.Box(0, 255, (16, 16, 3), np.uint8)
        self.action_space = gymnasium.spaces.MultiDiscrete([2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lamp = int(self.np_random.integers(2))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        right = float(action[self.lamp] == 1 and action[1 - self.lamp] == 0)
        self.lamp = int(self.np_random.integers(2))
        return self.render(), right, False, self.steps == 32, {}

    def render(self):
        frame = np.full((16, 16, 3), (30, 20, 20), np.uint8)
        frame[3:13, 8 * self.lamp : 8 * self.lamp + 8] = (250, 240, 120)
        return frame
