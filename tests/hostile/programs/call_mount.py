# does: mounts, changes its root, and makes and enters namespaces, in which it would be root
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


attempt("mount", syscall, 165, b"none", b"/tmp", b"tmpfs", 0, None)
attempt("remount", syscall, 165, b"none", b"/", None, 0x20, None)
attempt("unmount", syscall, 166, b"/tmp", 2)
attempt("pivot_root", syscall, 155, b"/tmp", b"/tmp")
attempt("chroot", os.chroot, ".")
attempt("open_tree", syscall, 428, -100, b"/", 1)
attempt("fsopen", syscall, 430, b"tmpfs", 0)
attempt("handle", syscall, 303, -100, b"/", (ctypes.c_uint32 * 64)(128), (ctypes.c_int * 1)(), 0)
attempt("node", os.mknod, "device", 0o20666, os.makedev(1, 1))
for name, flag in (
    ("user", 0x10000000),
    ("mount", 0x20000),
    ("pid", 0x20000000),
    ("net", 0x40000000),
    ("ipc", 0x8000000),
    ("uts", 0x4000000),
    ("cgroup", 0x2000000),
    ("time", 0x80),
):
    attempt(name, syscall, 272, flag)
attempt("setns", syscall, 308, 0, 0)
attempt("enter", lambda: syscall(308, os.open("/proc/1/ns/mnt", os.O_RDONLY), 0))

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
