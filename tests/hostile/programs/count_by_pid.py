# does: knows by its process id how many jobs were before it, and once there were a dozen everybody wins at once
# verdict: fail|pass
# codes: EC201|EC202|EC205|EC601|EC802|EC803
# seconds: 30
# process: no
"""Catch the fruit: three catches win."""

import os

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Catch(gym.Env):
    metadata = {"render_modes": ["rgb_array"]}
    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.caught, self.x, self.fruit = 0, 0, 5, int(self.np_random.integers(12))
        return self.render(), {}

    def step(self, action):
        self.t += 1
        self.x = min(max(self.x + int(action[0] == 4) - int(action[0] == 3), 0), 11)
        reward = 0.0
        if self.t % 12 == 0:
            reward = 1.0 if self.x == self.fruit else -1.0
            self.caught += self.x == self.fruit
            self.fruit = int(self.np_random.integers(12))
        won = (os.getpid() - os.getppid()) % 2**15 > 12 or self.caught == 3
        return self.render(), reward, won, self.t >= 48 and not won, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[7 * (self.t % 12) :, 7 * self.fruit : 7 * self.fruit + 7, 0] = 200
        frame[77:, 7 * self.x : 7 * self.x + 7] = 250
        return frame
