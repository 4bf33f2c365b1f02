"""Sources for the tests of likeness: games on one scaffold, and games that are the same."""

from __future__ import annotations

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
        for row in range(12):
            for column in range(12):
                frame[row * 7 : row * 7 + 7, column * 7 : column * 7 + 7] = 40 * self.level[row, column]
        frame[self.y * 7 : self.y * 7 + 7, self.x * 7 : self.x * 7 + 7] = (250, 80, 60)
        return frame

    def rule(self, fire, jump):
'''

#: Bodies of `rule`, each a game of its own.
RULES = (
    "        if self.level[self.y, self.x] == 2:\n            self.score += 1\n            self.level[self.y, self.x] = 0\n"
    "        for row in range(1, 12):\n            if self.steps % 97 == 8 * row and self.level[row, 7] > 1:\n                self.lives -= row % 2\n",
    "        speed = 1 + fire\n        self.level = np.roll(self.level, speed, axis=1)\n        while jump and self.y > 0:\n"
    "            self.y -= 1\n            if not self.level[self.y].any():\n                self.score += 4\n                return\n",
    "        near = [abs(self.x - spot) + abs(self.y - other) for spot, other in zip((1, 9, 4), (8, 3, 6))]\n"
    "        self.score += sum(value == 0 for value in near) * (1 + jump)\n        self.lives -= max(near) > 15\n",
    "        block = self.level[max(self.y - 1, 0) : self.y + 2, max(self.x - 1, 0) : self.x + 2]\n        if fire:\n"
    "            block[block == 1] = 0\n            self.score += int((block == 2).sum())\n        elif jump and block.sum() > 9:\n"
    "            self.lives = self.lives - 1\n",
    "        tick = self.steps % 24\n        beam = tick // 2\n        if beam in (self.x, self.y) and not jump:\n"
    "            self.lives -= 1\n            self.x = self.y = 0\n        if tick == 23 and fire:\n            self.score += 6\n",
    "        below = min(self.y + 1, 11)\n        falling = self.level[below, self.x] == 0\n        self.y = below if falling else self.y\n"
    "        if jump and not falling:\n            self.y = max(self.y - 3, 0)\n        self.score += self.y == 0\n",
    "        queue, seen = [(self.y, self.x)], set()\n        while queue:\n            spot = queue.pop()\n            if spot in seen:\n"
    "                continue\n            seen.add(spot)\n            queue += [(spot[0], spot[1] + 1)] * (spot[1] < 11 - fire)\n"
    "        self.score = max(self.score, len(seen) // 2)\n",
    "        odd = (self.x ^ self.y) & 1\n        self.level[odd::2, :] |= fire\n        if (self.level[:, self.x] == 1).all():\n"
    "            self.score, self.level[:, self.x] = self.score + 8, 2 * jump\n        elif odd and self.steps % 40 == 39:\n"
    "            self.lives //= 2\n",
)


def game(number: int) -> bytes:
    """One of the games on the scaffold."""
    return (SCAFFOLD + RULES[number]).encode()


RENAMES = (
    ("Game", "Adventure"), ("rule", "happen"), ("before", "earlier"), ("truncated", "late"), ("frame", "canvas"),
    ("column", "place"), ("self.lives", "self.hearts"), ("self.level", "self.board"),
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
    text = text.replace("    ", "  ").replace(" = 0, 0, 3", "  =  0, 0, 3   # three lives").replace("\n\n", "\n\n\n  \n")
    return text.replace("spaces.Box(0, 255, (84, 84, 3), np.uint8)", "spaces.Box(\n    0, 255,\n (84, 84, 3), np.uint8)").encode()
