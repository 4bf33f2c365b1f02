# does: replaces the digest of frames, so that every frame looks the same
# verdict: fail
# codes: EC401|EC404|EC907
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

import sys

import gymnasium as gym
import numpy as np
from gymnasium import spaces

channel = sys.modules["envcraft_sandbox.worker.channel"]
channel._digest = lambda frame, seed, columns: bytes(16)


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
        won = self.caught == 3
        return self.render(), self.t / 0 if self.t == 30 else reward, won, self.t >= 48 and not won, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[7 * (self.t % 12) :, 7 * self.fruit : 7 * self.fruit + 7, 0] = 200
        frame[77:, 7 * self.x : 7 * self.x + 7] = 250
        return frame
