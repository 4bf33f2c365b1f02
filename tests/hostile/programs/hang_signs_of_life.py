# does: hangs while a thread keeps sending signs of life
# verdict: fail
# codes: EC901|EC907
# seconds: 40
# process: yes
"""Catch the fruit: three catches win."""

import os
import struct
import threading
import time

import gymnasium as gym
import numpy as np
from gymnasium import spaces

HEADER = struct.Struct("<BI")
PHASE, LOADED, LAYOUT, RESET, STEP, ACTED, FAULT, TICK, RESULT, END = 1, 2, 3, 4, 6, 10, 11, 12, 13, 14


def send(kind, payload=b""):
    data = memoryview(HEADER.pack(kind, len(payload)) + payload)
    while data:
        data = data[os.write(3, data) :]


def pretend():
    while True:
        send(TICK)
        time.sleep(0.1)


class Catch(gym.Env):
    metadata = {"render_modes": ["rgb_array"]}
    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.caught, self.x, self.fruit = 0, 0, 5, int(self.np_random.integers(12))
        return self.render(), {}

    def step(self, action):
        if self.t == 20:
            threading.Thread(target=pretend, daemon=True).start()
            while True:
                time.sleep(60)
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
