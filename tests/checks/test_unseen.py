"""Losses by what no picture shows: an owl that is not drawn, and near-misses."""

from __future__ import annotations

from typing import Any

import pytest

import envcraft
from envcraft.model.verdict import Severity

#: The player loses where the owl is. It flies to and fro by itself.
GAME = """
import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Meadow(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 10}}
    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = spaces.MultiDiscrete([5, 2, 2])

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.y, self.steps = int(self.np_random.integers(12)), 11, 0
        self.goal = int(self.np_random.integers(12)), 0
        self.owls = [[int(self.np_random.integers(12)), row, 1] for row in (2, 4, 6, 8)]
        return self._frame(), {{"is_success": False}}

    def step(self, action):
        right, down = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))[int(action[0])]
        self.x, self.y = min(max(self.x + right, 0), 11), min(max(self.y + down, 0), 11)
        self.steps += 1
        for owl in self.owls:
            {flies}
        won = (self.x, self.y) == self.goal
        lost = any((self.x, self.y) == (column, row) for column, row, _ in self.owls)
        over = won or lost
        return self._frame(), 5.0 * won - lost, over, self.steps >= 300 and not over, {{"is_success": won}}

    def _frame(self):
        frame = np.zeros((12, 12, 3), np.uint8)
        frame[self.goal[1], self.goal[0]] = (250, 200, 60)
        frame[self.y, self.x] = (240, 240, 230)
        {drawn}
        return frame.repeat(7, axis=0).repeat(7, axis=1)

    def render(self):
        return self._frame()
"""
FLIES = "owl[2] *= -1 if not 0 <= owl[0] + owl[2] < 12 else 1; owl[0] += owl[2]"
DRAWN = "for column, row, _ in self.owls: frame[row, column] = (200, 70, 80)"


def warnings(flies: str = FLIES, drawn: str = "pass") -> list[str]:
    """The messages of EC406 about the game."""
    options: Any = {"sandbox": "process", "checks": "observation"}
    report = envcraft.validate(GAME.format(flies=flies, drawn=drawn), **options)
    findings = [finding for check in report.reports[0].checks for finding in check.findings]
    assert all(finding.severity is Severity.WARNING for finding in findings if finding.code == "EC406")
    return [finding.message for finding in findings if finding.code == "EC406"]


def test_an_owl_that_is_not_drawn() -> None:
    [message] = warnings()
    assert message.startswith("no picture shows the cause of a loss: in ")


@pytest.mark.parametrize(
    ("flies", "drawn"),
    [
        (FLIES, DRAWN),
        ("if self.steps % 8 == 0: owl[0] = (owl[0] + 1) % 12", DRAWN),
        # Owls that sit are lost on at any time, and one that flies by chance cannot be foreseen in any picture.
        ("pass", "pass"),
        ("owl[0] = int(self.np_random.integers(12))", "pass"),
    ],
)
def test_owls_that_are_drawn_or_stay_or_fly_by_chance(flies: str, drawn: str) -> None:
    assert not warnings(flies, drawn)
