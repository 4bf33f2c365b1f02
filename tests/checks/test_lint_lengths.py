"""Thresholds above the number of things in a game, and near-misses."""

from __future__ import annotations

import textwrap

import pytest

from tests.checks.lint_games import found

GAME = """
import gymnasium as gym
import numpy as np
GEMS = 6
class Game(gym.Env):
    action_space = gym.spaces.MultiDiscrete([5, 2, 2])
    def __init__(self):
        self.total, self.old = 0, []
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps, self.count, self.bonus, self.knocked = 0, 0, 0, 0, 0
        self.gems = [int(self.np_random.integers(9)) for _ in range(GEMS)]
        self.open = [True] * GEMS
        self.lit = [False] * len(self.open)
        half = self.np_random.random((2, 3)) < 0.7
        self.wall = np.concatenate([half, half[:, ::-1]], axis=1)
        self.doors = [{"at": n, "shut": True} for n in range(4)]
        self.keys = []
        for n in range(3):
            self.keys.append(n)
            self.old.append(n)
        return self.at, {}
    def step(self, action):
        self.steps += 1
        self.at += int(action[0])
STEP
        return self.at, 0.0, won, self.steps >= 900, {"is_success": won}
    def knock(self, row, column):
        if not (self.at > 2 and self.wall[row, column]):
            return len(np.argwhere(self.wall)) + self.wall.sum()
        self.wall[row, column] = False
        self.knocked += 1
    def refill(self):
        self.gems = [1, 2, 3]
        self.open[0] = True
    def left(self):
        return len(self.keys)
"""
TAKE = "if self.at in self.gems:\n    self.gems.remove(self.at)\n    self.count += 1\n"
OPEN = "if action[1] and self.open[self.at]:\n    self.open[self.at] = False\n    self.count += 1\n"
SHUT = (
    "for door in self.doors:\n    if door['shut'] and door['at'] == self.at:\n"
    "        door['shut'] = False\n        self.count += 1\n"
)
KNOCK = "self.knock(self.at % 2, self.at % 6)\n"
LIMITED = "truncated = self.steps >= 900\n"
LIGHT = "self.lit[self.at] = True\n"
SLAM = "for door in self.doors:\n    door['shut'] = True\n"


def codes(step: str) -> set[str]:
    return found(GAME.replace("STEP", textwrap.indent(step, " " * 8)))


@pytest.mark.parametrize(
    "step",
    [
        TAKE + "won = self.count > GEMS",
        TAKE + "won = self.count >= GEMS + 1",
        OPEN + "won = self.count > 6",
        SHUT + "won = self.count == 5",
        KNOCK + "won = self.knocked > 12",
        LIMITED + "self.bonus = self.bonus + 1 if self.at > 3 else 0\nwon = self.bonus > 999",
        LIGHT + "won = sum(self.lit) > 6",
        "won = len(self.keys) > 3",
        "won = self.left() >= 4",
        "won = len([gem for gem in self.gems if gem > 3]) > GEMS",
        "won = sum(1 for gem in self.gems if gem > 3) > GEMS",
        "self.gems = [gem for gem in self.gems if gem != self.at]\nwon = len(self.gems) > GEMS",
    ],
)
def test_a_threshold_above_the_number_of_things(step: str) -> None:
    assert codes(step) == {"EC059"}


@pytest.mark.parametrize(
    "step",
    [
        TAKE + "won = self.count >= GEMS",
        OPEN + "won = self.count == 6",
        SHUT + "won = self.count == 4",
        KNOCK + "won = self.knocked >= 12",
        LIMITED + "self.bonus = self.bonus + 1 if self.at > 3 else 0\nwon = self.bonus > 800",
        LIMITED + "self.bonus = self.bonus + self.at if self.at > 3 else 0\nwon = self.bonus > 999",
        KNOCK + "self.wall[0, 0] = True\nwon = self.knocked > 12",
        LIGHT + "won = sum(self.lit) >= 6",
        LIGHT + "self.lit[0] = 9\nwon = sum(self.lit) > 6",
        "won = len(self.keys) >= 3",
        "won = sum(gem for gem in self.gems) > GEMS",
        # The level is filled again.
        TAKE + "if not self.gems:\n    self.refill()\nwon = self.count > GEMS",
        OPEN + "if action[2]:\n    self.refill()\nwon = self.count > GEMS",
        SHUT + SLAM + "won = self.count > 4",
        TAKE + "if self.steps % 50 == 0:\n    self.gems.append(3)\nwon = self.count > GEMS",
        # Something else counts, too.
        TAKE + "if self.at == 7:\n    self.count += 1\nwon = self.count > GEMS",
        TAKE + OPEN + "won = self.count > GEMS",
        # Nothing says that the door was open.
        "self.open[self.at] = False\nself.count += 1\nwon = self.count > GEMS",
        TAKE + "if action[2]:\n    self.gems[:0] = [1, 2]\nwon = self.count > GEMS",
        # It was never set back, and goes on over episodes.
        TAKE.replace("count", "total") + "won = self.total > GEMS",
        "won = len(self.old) > 3",
        # The list has another name, under which it grows.
        "more = self.keys\nmore.append(5)\nwon = len(self.keys) > 3",
        "sorted_in(self.keys)\nwon = len(self.keys) > 3",
    ],
)
def test_a_threshold_that_may_be_reached(step: str) -> None:
    assert "EC059" not in codes(step)
