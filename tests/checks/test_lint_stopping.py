"""What the check lint reports about pictures that show nothing new once a flag is set."""

from __future__ import annotations

import ast

import pytest
from envcraft_checks.linting.program import Program
from envcraft_checks.linting.stopping import stopped_pictures

GAME = """
import gymnasium as gym
import numpy as np
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.coins, self.hearts, self.steps = 0, 0, 3, 0
        self.flag = self.won = self.over = False
        self.still = None
        return self.look(), {}
    def step(self, action):
        self.steps += 1
        if not self.over:
            self.move(action)
        EVENT
        lost = self.hearts <= 0
        terminated = lost or self.won or self.over
        return self.look(), 0.0, terminated, self.steps >= 99, {}
    def move(self, action):
        self.at += int(action[0])
        if self.at == 5:
            self.take()
    def take(self):
        self.coins += 1
        self.flag = True
        return 1.0
    def is_lost(self):
        return self.flag
    def finish(self):
        self.over = True
    def look(self):
        image = np.full((84, 84, 3), self.at, np.uint8)
        LOOK
        return image
"""


def reports(look: str, old: str = "", new: str = "", event: str = "pass") -> list[str]:
    """What the rule says of a game with these statements in its drawing method and in step(), and with other text."""
    assert old in GAME
    text = GAME.replace(old, new) if old else GAME
    text = text.replace("LOOK", look.replace("\n", "\n        ")).replace("EVENT", event.replace("\n", "\n        "))
    return [suspect.words for suspect in stopped_pictures(Program(ast.parse(text)))]


BLANK = "if self.flag:\n    return np.zeros((84, 84, 3), np.uint8)"
KEPT = "if not self.flag or self.still is None:\n    self.still = image\nreturn self.still.copy()"


@pytest.mark.parametrize(
    "look",
    [
        BLANK,
        KEPT,
        "return np.zeros_like(image) if self.flag else image",
        "return image * (not self.flag)",
        "return np.uint8(not self.flag) * image",
        "if not self.flag:\n    self.still = image\nreturn self.still",
        "if self.flag:\n    pass\nelse:\n    self.still = image\nreturn self.still",
    ],
)
def test_a_picture_that_stops(look: str) -> None:
    assert len(reports(look)) == 1


@pytest.mark.parametrize("look", [BLANK, KEPT])
@pytest.mark.parametrize(
    ("old", "new", "event"),
    [
        # Play clears the flag.
        ("", "", "if self.at > 9:\n    self.flag = False"),
        # The episode ends where the flag is set.
        ("self.flag = True", "self.flag = self.over = True", "pass"),
        ("self.flag = True", "pass", "if self.at > 9:\n    self.flag = True\n    self.won = True"),
        ("self.flag = True", "pass", "if self.hearts <= 0:\n    self.flag = True"),
        ("self.flag = True", "pass", "if self.at > 5 and self.won:\n    self.flag = True"),
        ("self.flag = True", "pass", "if self.at > 9:\n    self.flag = True\n    return 0, 1.0, True, False, {}"),
        # It ends beside the call.
        ("self.take()", "self.take()\n            self.over = True", "pass"),
        ("self.take()", "self.take()\n            self.finish()", "pass"),
        # The flag itself ends it.
        ("lost = self.hearts <= 0", "lost = self.flag", "pass"),
        ("lost = self.hearts <= 0", "lost = self.is_lost()", "pass"),
        # reset() may run in play.
        ("self.take()", "self.take()\n            self.reset()", "pass"),
    ],
)
def test_a_picture_that_goes_on(look: str, old: str, new: str, event: str) -> None:
    assert not reports(look, old, new, event)


@pytest.mark.parametrize(
    "look",
    [
        # The picture is drawn in any case, or another one is.
        "self.still = image\nif not self.flag:\n    self.still = image\nreturn self.still",
        "if not self.flag or self.at > 50:\n    self.still = image\nreturn self.still",
        "if self.flag:\n    return np.full((84, 84, 3), self.at, np.uint8)",
        "return image * (not self.at)",
    ],
)
def test_a_picture_that_changes(look: str) -> None:
    assert not reports(look)
