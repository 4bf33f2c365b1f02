# does: takes memory, descriptors and time from the process that started it, and raises its own limits
# verdict: pass
# codes:
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

import os
import resource

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


for name in ("RLIMIT_AS", "RLIMIT_NOFILE", "RLIMIT_CPU", "RLIMIT_FSIZE"):
    attempt(name, resource.prlimit, os.getppid(), getattr(resource, name), (1, 1))
attempt("priority", os.setpriority, os.PRIO_PROCESS, os.getppid(), 19)
attempt("affinity", os.sched_setaffinity, os.getppid(), {0})
attempt("scheduler", os.sched_setscheduler, os.getppid(), os.SCHED_IDLE, os.sched_param(0))


def raised(name):
    number = getattr(resource, name)
    resource.setrlimit(number, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


for name in ("RLIMIT_AS", "RLIMIT_DATA", "RLIMIT_NOFILE", "RLIMIT_FSIZE", "RLIMIT_CORE"):
    attempt(name, raised, name)
attempt("priority", os.setpriority, os.PRIO_PROCESS, 0, -20)
attempt("real time", os.sched_setscheduler, 0, os.SCHED_FIFO, os.sched_param(50))

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
