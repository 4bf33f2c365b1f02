"""An environment that cannot be played is undecided by each check that judges play, never passed."""

from __future__ import annotations

import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named, select_checks
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Outcome

GAME = """
import gymnasium as gym
import numpy as np


class Lamp(gym.Env):
    def __init__(self, render_mode=None):
        self.observation_space = gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = gym.spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return RESET

    def step(self, action):
        return STEP
"""
FRAME = "np.zeros((84, 84, 3), np.uint8)"
RAISES = {"RESET": f"{FRAME}, {{}}", "STEP": "1 / 0"}
FOUR_VALUES = {"RESET": f"{FRAME}, {{}}", "STEP": f"{FRAME}, 0.0, False, {{}}"}
ONE_VALUE = {"RESET": FRAME, "STEP": f"{FRAME}, 0.0, False, False, {{}}"}


@pytest.mark.parametrize(
    "check", ["determinism", "reward", "observation", "termination", "instawin", "instadeath", "difficulty"]
)
@pytest.mark.parametrize("parts", [RAISES, FOUR_VALUES, ONE_VALUE], ids=["raises", "four values", "one value"])
def test_a_check_of_play_does_not_pass_without_play(check: str, parts: dict[str, str]) -> None:
    source = GAME
    for name, text in parts.items():
        source = source.replace(name, text)
    targets, driver = [Target("lamp.py", source.encode())], driver_named("process")
    plan = Plan(targets, ARCADE, driver, select_checks(check, None), BUDGETS["quick"])
    (report,) = next(event.report.reports for event in validate(plan) if isinstance(event, Finished))
    assert report.outcome is Outcome.UNDECIDED
