"""Ends at the step limit, and resets without a seed, in a game of falling leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import envcraft

_GAME = '''
"""Catch ten leaves with the basket."""
import random
import gymnasium as gym
import numpy as np
from gymnasium import spaces

MAX_STEPS = {limit}


class Leaves(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.background = {background}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.caught, self.x = 0, 0, 5
        self.leaf = {leaf}
        return self.render(), {{"is_success": False}}

    def step(self, action):
        self.steps += 1
        self.x = min(max(self.x + int(action[0] == 4) - int(action[0] == 3), 0), 11)
        reward = 0.0
        if self.steps % 12 == 0:
            reward = 1.0 if self.x == self.leaf else -0.1
            self.caught += self.x == self.leaf
            self.leaf = int(self.np_random.integers(12))
        won = self.caught == 10
        late = self.steps >= MAX_STEPS and not won
        return self.render(), reward, {terminated}, {truncated}, {{"is_success": won}}

    def render(self):
        frame = np.full((84, 84, 3), self.background, np.uint8)
        frame[7 * (self.steps % 12) :, 7 * self.leaf : 7 * self.leaf + 7, 0] = 200
        frame[77:, 7 * self.x : 7 * self.x + 7] = 250
        return frame
'''
_DRAWN = "int(self.np_random.integers(12))"


def _found(**parts: Any) -> dict[str, str]:
    usual = {"limit": 400, "background": 20, "leaf": _DRAWN, "terminated": "won", "truncated": "late"}
    source = _GAME.format(**usual | parts)
    report = envcraft.validate(source, sandbox="process", budget="quick")
    return {finding.code: finding.message for check in report.reports[0].checks for finding in check.findings}


def test_the_game_is_sound() -> None:
    assert not _found().keys() - {"EC505"}


@pytest.mark.parametrize("truncated", ["late", "False"])
def test_a_limit_that_terminates_is_wrong_even_if_it_also_truncates(truncated: str) -> None:
    found = _found(limit=1000, terminated="won or late", truncated=truncated)
    assert ("and truncated" if truncated == "late" else "not truncated") in found["EC502"]


def test_a_short_limit_that_terminates_is_no_loss_at_once() -> None:
    assert not {"EC502"} ^ _found(limit=30, terminated="won or late", truncated="False").keys() & {"EC502", "EC701"}


def test_resets_without_a_seed_are_compared_with_seeds_on_a_like_instance() -> None:
    painted = "random.randrange(40)"
    # The next leaf differs later than these resets play.
    assert "EC212" not in _found(background=painted, leaf="5")
    fixed = f"{_DRAWN} if seed is not None else 5"
    assert "EC212" in _found(leaf=fixed)


@pytest.mark.parametrize("chosen", ["7 if seed is None else seed", "seed or 7"])
def test_a_seed_that_the_code_chooses_is_seen_where_few_levels_differ(chosen: str) -> None:
    game = Path(__file__).resolve().parents[1] / "fixtures" / "instawin" / "good" / "sword_duel.py"
    text = game.read_text().replace("super().reset(seed=seed)", f"super().reset(seed={chosen})")
    report = envcraft.validate(text, sandbox="process", budget="quick", checks=["determinism"])
    [finding] = [finding for check in report.reports[0].checks for finding in check.findings]
    assert finding.code == "EC212"
    assert "super().reset" in text.splitlines()[(finding.line or 0) - 1]
