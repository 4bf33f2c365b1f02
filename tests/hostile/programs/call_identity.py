# does: becomes another user, gains capabilities, and turns the randomisation of addresses off
# verdict: pass
# codes:
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

import ctypes
import os

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


def become(change, *identity):
    change(*identity)


attempt("groups", become, os.setgroups, [0])
attempt("group", become, os.setresgid, 12345, 12345, 12345)
attempt("user", become, os.setresuid, 12345, 12345, 12345)
attempt("root", lambda: os.getuid() != 0 and become(os.setuid, 0) is None)
attempt("capabilities", syscall, 126, (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)(1, 1, 0, 0, 0, 0))
attempt("ambient", lambda: LIBC.prctl(47, 2, 21, 0, 0) == 0)
attempt("secure bits", lambda: LIBC.prctl(28, 1, 0, 0, 0) == 0)
attempt("addresses", syscall, 135, 0x0040000)
attempt("read implies exec", syscall, 135, 0x0400000)
attempt("descriptor table", syscall, 154, 1, ctypes.create_string_buffer(16), 16)
attempt("ports", syscall, 172, 3)

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
