# near-miss: the first frames are black and the brightest ever is dim, but the picture fades in within the first 64.
"""Dawn: reach the hut, to the left or to the right; it is night at first."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Dawn(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.steps, self.hut = 42, 0, int(self.np_random.choice([4, 12, 68, 76]))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.x = min(max(self.x + {3: -1, 4: 1}.get(int(action[0]), 0), 0), 83)
        home = self.x == self.hut
        return self.render(), float(home), home, self.steps >= 200, {"is_success": home}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        light = min(self.steps // 2, 20)
        frame[50:, :] = light // 2
        frame[46:50, self.hut : self.hut + 4] = light
        frame[48:50, self.x : self.x + 2] = light
        return frame
