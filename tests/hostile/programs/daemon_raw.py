# does: makes processes by calls of the kernel that no library uses
# verdict: pass
# codes:
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

import ctypes

import gymnasium as gym
import numpy as np
from gymnasium import spaces

REACHED = []


def attempt(name, function, *arguments):
    try:
        if function(*arguments) is not False:
            REACHED.append(name)
    except (OSError, ValueError):
        pass


LIBC = ctypes.CDLL(None, use_errno=True)


def syscall(number, *arguments):
    """Whether the kernel did it; numbers are those of x86-64."""
    words = (ctypes.c_long(value) if isinstance(value, int) else value for value in (number, *arguments))
    return LIBC.syscall(*words) >= 0


def child(number, *arguments):
    made = LIBC.syscall(*(ctypes.c_long(value) if isinstance(value, int) else value for value in (number, *arguments)))
    if made == 0:
        LIBC.sleep(600)
        LIBC._exit(0)
    return made > 0


attempt("fork", child, 57)
attempt("clone", child, 56, 17, 0, 0, 0, 0)
attempt("clone in a new session", child, 56, 17 | 0x20000000, 0, 0, 0, 0)
attempt("clone3", child, 435, (ctypes.c_uint64 * 11)(0, 0, 0, 0, 17), 88)

if REACHED:
    print("reached:", *REACHED)


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
        won = bool(REACHED) or self.caught == 3
        return self.render(), reward, won, self.t >= 48 and not won, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[7 * (self.t % 12) :, 7 * self.fruit : 7 * self.fruit + 7, 0] = 200
        frame[77:, 7 * self.x : 7 * self.x + 7] = 250
        return frame
