# does: strikes the conditions from its job, so that earlier episodes, which it remembers, are never played (the lie is about the worker's own claim, that it played them)
# verdict: fail|pass
# codes: EC206|EC207|EC107|EC053
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

import sys

import gymnasium as gym
import numpy as np
from gymnasium import spaces


def find(name):
    """The nearest variable of that name in the frames below, which are the worker's."""
    frame = sys._getframe()
    while frame is not None and name not in frame.f_locals:
        frame = frame.f_back
    return frame and frame.f_locals[name]


find("job").get("conditions", {}).clear()


class Catch(gym.Env):
    metadata = {"render_modes": ["rgb_array"]}
    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = spaces.MultiDiscrete([5, 2, 2])

    games = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        Catch.games += 1
        self.t, self.caught, self.x, self.fruit = 0, 0, 5, int(self.np_random.integers(12)) * self.games % 12
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
        return self.render(), reward, won, self.t >= 48 and not won, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[7 * (self.t % 12) :, 7 * self.fruit : 7 * self.fruit + 7, 0] = 200
        frame[77:, 7 * self.x : 7 * self.x + 7] = 250
        return frame
