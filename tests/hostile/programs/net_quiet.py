# does: tries to reach servers of the machine and of the world by every kind of socket, and hides it where it cannot
# verdict: pass
# codes:
# seconds: 30
# process: yes
"""Catch the fruit: three catches win."""

import socket

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


def udp(address):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sent:
        sent.sendto(b"x", address)


def abstract():
    with socket.socket(socket.AF_UNIX) as tried:
        tried.connect("\0@abstract@")


attempt("tcp", socket.create_connection, ("127.0.0.1", int("@tcp@")), 0.2)
attempt("world", socket.create_connection, ("192.0.2.1", 80), 0.2)
attempt("udp", udp, ("127.0.0.1", int("@udp@")))
attempt("name server", udp, ("192.0.2.1", 53))
attempt("abstract", abstract)
for name, family, kind in (
    ("netlink", 16, socket.SOCK_RAW),
    ("packet", 17, socket.SOCK_RAW),
    ("crypto", 38, socket.SOCK_SEQPACKET),
    ("vsock", 40, socket.SOCK_STREAM),
    ("xdp", 44, socket.SOCK_RAW),
    ("raw", socket.AF_INET, socket.SOCK_RAW),
    ("ping", socket.AF_INET, socket.SOCK_DGRAM),
    ("inet6", socket.AF_INET6, socket.SOCK_STREAM),
    ("bluetooth", 31, socket.SOCK_RAW),
):
    attempt(name, lambda family=family, kind=kind: socket.socket(family, kind).close())

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
