# does: asks for io_uring, bpf, perf events, user faults, modules, the kernel's log and other ways into the kernel
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


room = ctypes.create_string_buffer(256)
room[0:8] = (128).to_bytes(8, "little")
attempt("bpf", syscall, 321, 0, (ctypes.c_uint32 * 32)(2, 4, 4, 1), 128)
attempt("perf_event_open", syscall, 298, (ctypes.c_uint32 * 32)(1, 128), 0, -1, -1, 0)
attempt("userfaultfd", syscall, 323, 1)
attempt("init_module", syscall, 175, room, 8, b"")
attempt("kexec", syscall, 246, 0, 0, None, 0)
attempt("syslog", syscall, 103, 3, room, 256)
attempt("fanotify", syscall, 300, 0, 0)
attempt("memfd_secret", syscall, 447, 0)
attempt("quota", syscall, 179, 0x80000100, b"/dev/vda", 0, room)
attempt("reboot", syscall, 169, 0, 0, 0, None)
attempt("swap", syscall, 167, b"/dev/zero", 0)
attempt("clock", syscall, 227, 0, (ctypes.c_uint64 * 2)(1, 1))
attempt("host name", syscall, 170, b"owned", 5)
attempt("io_uring", syscall, 425, 4, ctypes.create_string_buffer(256))
attempt("io_setup", syscall, 206, 4, (ctypes.c_uint64 * 1)())

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
