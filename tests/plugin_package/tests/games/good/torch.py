# near-miss: all but two of 7,056 pixels are black, which an average would call dark, but both can be seen.
"""Torch: carry the torch through a dark corridor to the door, to the left or to the right."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Torch(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.steps, self.door = 42, 0, int(self.np_random.choice([4, 12, 68, 76]))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.x = min(max(self.x + {3: -1, 4: 1}.get(int(action[0]), 0), 0), 83)
        out = self.x == self.door
        return self.render(), float(out), out, self.steps >= 200, {"is_success": out}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[42, self.door] = (90, 60, 0)
        frame[42, self.x] = 255
        return frame
