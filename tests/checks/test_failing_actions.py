"""An observation is not called useless if the action that may show in it always fails."""

from __future__ import annotations

import pytest

import envcraft
from envcraft.model.verdict import Verdict

GAME = """
import gymnasium as gym
import numpy as np


class Walk(gym.Env):
    observation_space = gym.spaces.MultiDiscrete([10, 100])
    action_space = gym.spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = 0, int(self.np_random.integers(5))
        return self.see(), {}

    def step(self, action):
        move = {0: "left", 1: "stay"}[int(action)]
        self.steps += 1
        self.at = max(self.at - 1, 0) if move == "left" else self.at
        return self.see(), 0.0, False, self.steps >= 50, {}

    def see(self):
        return np.array([self.at, self.steps])
"""
CONSTANT = ("np.array([self.at, self.steps])", "np.array([self.at, 0])")
ALL_MOVES = ('1: "stay"}', '1: "stay", 2: "stay"}')
RARELY = ("self.steps += 1", "self.steps += 1; assert action < 2 or self.steps < 40")


def judged(*changes: tuple[str, str]) -> tuple[list[str], str]:
    """The codes of findings on the game, and why the check of observations is undecided."""
    text = GAME
    for old, new in changes:
        assert text.count(old) == 1
        text = text.replace(old, new)
    report = envcraft.validate(text, contract="gymnasium", checks="api,observation").reports[0]
    (own,) = [check for check in report.checks if check.check == "observation"]
    assert own.undecided == (own.verdict is Verdict.SKIP)
    return [finding.code for check in report.checks for finding in check.findings], own.reason


@pytest.mark.parametrize("changes", [(), (CONSTANT,)])
def test_the_action_that_fails_may_show(changes: tuple[tuple[str, str], ...]) -> None:
    why = "step() fails at the action 2, so no observation after it could be compared"
    assert judged(*changes) == (["EC107"], why)


@pytest.mark.parametrize(
    ("changes", "codes"),
    [
        ((ALL_MOVES,), ["EC403"]),
        ((ALL_MOVES, CONSTANT), ["EC401"]),
        ((ALL_MOVES, RARELY), ["EC107", "EC403"]),
    ],
)
def test_actions_that_do_not_fail_are_compared(changes: tuple[tuple[str, str], ...], codes: list[str]) -> None:
    assert judged(*changes) == (codes, "")
