"""What the check lint reports about lists that a counter reads to their end."""

from __future__ import annotations

import ast

import pytest
from envcraft_checks.linting.program import Program
from envcraft_checks.linting.running_out import short_lists

GAME = """
import gymnasium as gym
import numpy as np
TONES = (1, 2, 3)
COINS = 5
class Game(gym.Env):
    speeds = [1, 2, 4]
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.coins, self.hearts, self.steps, self.level = 0, 0, 3, 0, 0
        self.level = 0
        self.colours = [10, 20, 30]
        return self.at, {}
    def step(self, action):
        self.steps += 1
        self.at += int(action[0])
        if self.at % 7 == 0:
            EVENT
        won = self.coins >= COINS
        lost = self.hearts <= 0
        return self.at, 0.0, won or lost, self.steps >= 99, {"level": self.level}
"""


def reports(event: str, old: str = "", new: str = "") -> list[str]:
    """What the rule says of a game with these statements at an event, and with other text."""
    assert old in GAME
    text = (GAME.replace(old, new) if old else GAME).replace("EVENT", event.replace("\n", "\n            "))
    return [suspect.words for suspect in short_lists(Program(ast.parse(text)))]


@pytest.mark.parametrize(
    "event",
    [
        "self.level += 1\nself.at = self.colours[self.level]",
        "self.level += 1\nself.at = self.speeds[self.level]",
        "self.level += 1\nself.at = TONES[self.level]",
        "self.at = self.colours[self.level]\nself.level += 1",
        # Five coins are more than three items, and the third heart is the third item.
        "self.coins += 1\nself.level += 1\nself.at = self.colours[self.level]",
        "self.hearts -= 1\nself.level += 1\nself.at = self.colours[self.level]",
        "try:\n    self.level += 1\n    self.at = self.colours[self.level]\nexcept KeyError:\n    pass",
    ],
)
def test_a_list_that_runs_out(event: str) -> None:
    [words] = reports(event)
    assert "has 3 items" in words


READ = "self.level += 1\nself.at = self.colours[self.level]"
ELSEWHERE = "COINS = 5\ndef cut(env):\n    env.level -= 1"


@pytest.mark.parametrize(
    ("event", "old", "new"),
    [
        ("self.level += 1\nself.at = self.colours[min(self.level, 2)]", "", ""),
        ("self.level += 1\nself.at = self.colours[self.level % 3]", "", ""),
        ("if self.level < 2:\n    self.level += 1\nself.at = self.colours[self.level]", "", ""),
        ("self.level += 1\nself.level = min(self.level, 2)\nself.at = self.colours[self.level]", "", ""),
        ("self.level = 1\nself.at = self.colours[self.level]", "", ""),
        (READ, "won = self", "won = self.level == 3 or self"),
        (READ, "lost = ", "full = self.level\n        lost = "),
        (READ, "COINS = 5", ELSEWHERE),
        # The list is longer than what is written out.
        (f"self.colours.append(4)\n{READ}", "", ""),
        (READ, "[10, 20, 30]", "list(range(9))"),
        (READ, "[10, 20, 30]", "[10, *TONES]"),
        # The episode ends before, or may do so.
        (f"self.coins += 1\n{READ}", "COINS = 5", "COINS = 2"),
        (f"self.coins += 1\n{READ}", "COINS = 5", "COINS = int('5')"),
        (f"self.hearts -= 1\n{READ}", "0, 0, 3, 0, 0", "0, 0, 2, 0, 0"),
        ("try:\n    self.at = self.colours[self.level]\nexcept IndexError:\n    pass\nself.level += 1", "", ""),
    ],
)
def test_a_list_that_does_not(event: str, old: str, new: str) -> None:
    assert reports(event, old, new) == []
