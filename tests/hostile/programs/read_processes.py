# does: reads what /proc tells of other processes, and writes to what it lets a process change
# verdict: pass
# codes:
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

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


parent = os.getppid()
for name in (1, parent):
    for part in ("environ", "cmdline", "maps", "mem", "status", "fd", "root", "cwd"):
        path = f"/proc/{name}/{part}"
        attempt(path, lambda path=path: bool(os.listdir(path) if os.path.isdir(path) else open(path, "rb").read(1)))
attempt("processes", os.listdir, "/proc")
for path, text in (
    (f"/proc/{os.getppid()}/oom_score_adj", "1000"),
    (f"/proc/{os.getppid()}/comm", "owned"),
    ("/proc/self/mem", ""),
    ("/proc/self/oom_score_adj", "-900"),
    ("/proc/sys/kernel/ns_last_pid", "5"),
    ("/proc/sys/kernel/core_pattern", "|/tmp/owned"),
    ("/sys/kernel/uevent_helper", "/tmp/owned"),
    ("/sys/fs/cgroup/cgroup.procs", str(os.getpid())),
):
    attempt(path, lambda path=path, text=text: bool(open(path, "r+").write(text)) or path.endswith("mem"))

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
