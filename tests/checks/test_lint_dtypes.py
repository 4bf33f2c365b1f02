"""Pictures of uint8 that a branch makes float64."""

from __future__ import annotations

import textwrap

import pytest

from tests.checks.lint_games import found

GAME = """
import gymnasium as gym
import numpy as np
class Game(gym.Env):
    observation_space = gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.glow = int(self.np_random.integers(9)), 0
        return self._draw(), {}
    def step(self, action):
        self.at += int(action[0])
        self.glow = 5 if self.at == 40 else max(self.glow - 1, 0)
        frame = self._draw()
        return frame, 0.0, self.at > 70, False, {}
    def _sky(self):
        return np.full((84, 84, 3), (10, 20, 30), dtype=np.uint8)
    def _draw(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[self.at] = 255
DRAW
"""


def codes(draw: str) -> set[str]:
    return found(GAME.replace("DRAW", textwrap.indent(draw, " " * 8)))


@pytest.mark.parametrize(
    "draw",
    [
        "if self.glow:\n    frame = frame * 1.5\nreturn frame",
        "if self.glow:\n    frame = np.clip(frame * (1 + 0.1 * self.glow), 0, 255)\nreturn frame",
        "if self.glow:\n    frame = frame / 2\nreturn frame",
        "frame = self._sky()\nif self.glow:\n    frame = (frame * 0.5 + 20).clip(0, 255)\nreturn frame",
        "if self.glow:\n    frame[3:9] *= 0.5\nreturn frame",
        "if self.glow:\n    frame = frame.astype(np.float32) * 2\nelse:\n    frame = frame + 1\nreturn frame",
    ],
)
def test_a_branch_that_makes_floats(draw: str) -> None:
    expected = {"EC064"}
    assert codes(draw.replace("return frame", "return frame")) == expected


@pytest.mark.parametrize(
    "draw",
    [
        "if self.glow:\n    frame = (frame * 1.5).astype(np.uint8)\nreturn frame",
        "if self.glow:\n    frame = frame * 1.5\n    frame = frame.astype(np.uint8)\nreturn frame",
        "if self.glow:\n    if self.at:\n        frame = frame * 0.5\n    frame = frame.astype(np.uint8)\nreturn frame",
        "if self.glow:\n    frame = frame * 1.5\nreturn frame.astype(np.uint8)",
        "if self.glow:\n    frame = frame * 1.5\nframe = np.clip(frame, 0, 255).astype('uint8')\nreturn frame",
        "if self.glow:\n    frame = frame // 2\nreturn frame",
        "if self.glow:\n    frame[3:9] = frame[3:9] * 0.5\nreturn frame",
        "light = frame * 0.5\nreturn frame",
        "if self.glow:\n    frame += 9\nreturn frame",
        "frame = np.zeros((84, 84, 3))\nif self.glow:\n    frame = frame * 0.5\nreturn frame.astype(np.uint8)",
    ],
)
def test_a_picture_that_stays_uint8(draw: str) -> None:
    assert codes(draw) == set()


def test_another_space() -> None:
    draw = "if self.glow:\n    frame = frame * 1.5\nreturn frame"
    text = GAME.replace("DRAW", textwrap.indent(draw, " " * 8))
    assert found(text.replace("(84, 84, 3), np.uint8)\n    def", "(84, 84, 3))\n    def")) == set()
