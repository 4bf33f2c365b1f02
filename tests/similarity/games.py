"""Sources for the tests of likeness: games on one scaffold, and games that are the same."""

from __future__ import annotations

import textwrap

SCAFFOLD = '''import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Game(gym.Env):
    """A game."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.score, self.lives = 0, 0, 3
        self.x, self.y = 5, 5
        self.level = self.np_random.integers(0, 3, (12, 12))
        return self.render(), {"score": self.score, "lives": self.lives}

    def step(self, action):
        move, fire, jump = (int(part) for part in action)
        self.steps += 1
        before = self.score
        dx, dy = {0: (0, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}[move]
        self.x = min(max(self.x + dx, 0), 11)
        self.y = min(max(self.y + dy, 0), 11)
        self.rule(fire, jump)
        terminated = self.lives <= 0
        truncated = not terminated and self.steps >= 500
        info = {"score": self.score, "lives": self.lives, "is_success": self.score >= 10}
        return self.render(), float(self.score - before), terminated, truncated, info

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        for column in range(12):
            strip = 40 * self.level[:, column].repeat(7)
            frame[:, column * 7 : column * 7 + 7] = strip[:, np.newaxis, np.newaxis]
        frame[self.y * 7 : self.y * 7 + 7, self.x * 7 : self.x * 7 + 7] = (250, 80, 60)
        return frame

    def rule(self, fire, jump):
'''

#: Bodies of `rule`, each a game of its own.
RULES = (
    """
if self.level[self.y, self.x] == 2:
    self.score += 1
    self.level[self.y, self.x] = 0
for row in range(1, 12):
    if self.steps % 97 == 8 * row and self.level[row, 7] > 1:
        self.lives -= row % 2
    """,
    """
speed = 1 + fire
self.level = np.roll(self.level, speed, axis=1)
while jump and self.y > 0:
    self.y -= 1
    if not self.level[self.y].any():
        self.score += 4
        return
    """,
    """
near = [abs(self.x - spot) + abs(self.y - other) for spot, other in zip((1, 9, 4), (8, 3, 6))]
self.score += sum(value == 0 for value in near) * (1 + jump)
self.lives -= max(near) > 15
    """,
    """
block = self.level[max(self.y - 1, 0) : self.y + 2, max(self.x - 1, 0) : self.x + 2]
if fire:
    block[block == 1] = 0
    self.score += int((block == 2).sum())
elif jump and block.sum() > 9:
    self.lives = self.lives - 1
    """,
    """
tick = self.steps % 24
beam = tick // 2
if beam in (self.x, self.y) and not jump:
    self.lives -= 1
    self.x = self.y = 0
if tick == 23 and fire:
    self.score += 6
    """,
    """
below = min(self.y + 1, 11)
falling = self.level[below, self.x] == 0
self.y = below if falling else self.y
if jump and not falling:
    self.y = max(self.y - 3, 0)
self.score += self.y == 0
    """,
    """
queue, seen = [(self.y, self.x)], set()
while queue:
    spot = queue.pop()
    if spot in seen:
        continue
    seen.add(spot)
    queue += [(spot[0], spot[1] + 1)] * (spot[1] < 11 - fire)
self.score = max(self.score, len(seen) // 2)
    """,
    """
odd = (self.x ^ self.y) & 1
self.level[odd::2, :] |= fire
if (self.level[:, self.x] == 1).all():
    self.score, self.level[:, self.x] = self.score + 8, 2 * jump
elif odd and self.steps % 40 == 39:
    self.lives //= 2
    """,
)


def game(number: int) -> bytes:
    """One of the games on the scaffold."""
    body = RULES[number].strip()
    return (SCAFFOLD + textwrap.indent(body, " " * 8) + "\n").encode()


RENAMES = (
    ("Game", "Adventure"),
    ("rule", "happen"),
    ("before", "earlier"),
    ("truncated", "late"),
    ("frame", "canvas"),
    ("column", "place"),
    ("self.lives", "self.hearts"),
    ("self.level", "self.board"),
)


def renamed(source: bytes) -> bytes:
    """The same program with other names for a class, methods, attributes and variables."""
    text = source.decode()
    for old, new in RENAMES:
        text = text.replace(old, new)
    # Keys of info are data.
    return text.replace('"hearts"', '"lives"').encode()


def reformatted(source: bytes) -> bytes:
    """The same tokens under other comments, docstrings, spaces and breaks."""
    text = source.decode().replace('"""A game."""', '"""Another description."""\n    # and a remark')
    text = (
        text.replace("    ", "  ").replace(" = 0, 0, 3", "  =  0, 0, 3   # three lives").replace("\n\n", "\n\n\n  \n")
    )
    return text.replace(
        "spaces.Box(0, 255, (84, 84, 3), np.uint8)", "spaces.Box(\n    0, 255,\n (84, 84, 3), np.uint8)"
    ).encode()
