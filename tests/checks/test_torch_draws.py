"""Draws from the global generator of torch are not mistaken for the clock or the process."""

from __future__ import annotations

import importlib.util

import pytest
from envcraft_checks.linting.generators import generators
from envcraft_checks.linting.program import Program

import envcraft
from envcraft.model.target import parse

GAME = """
import gymnasium as gym
import torch


class Corridor(gym.Env):
    observation_space = gym.spaces.Discrete(40)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = int(self.np_random.integers(5))
        self.rng = torch.Generator().manual_seed(self.at)
        self.steps = 0
        return self.at, {}

    def step(self, action):
        slips = torch.rand(1) < 0.3
        self.steps += 1
        self.at = max(self.at + (0 if slips else 2 * int(action) - 1), 0)
        return self.at, float(self.at == 39), self.at == 39, self.steps >= 200, {}
"""
OWN = GAME.replace("torch.rand(1)", "torch.rand(1, generator=self.rng)")
SEEDED = GAME.replace("self.rng =", "torch.manual_seed(self.at); self.rng =")
installed = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="torch is not installed")


@pytest.mark.parametrize("text", [GAME, GAME.replace("rand(1) <", "randint(0, 9, (1,)) <")])
def test_a_draw_is_read(text: str) -> None:
    (suspect,) = generators(Program(parse(text), "Corridor"))
    assert "torch.rand" in text.splitlines()[suspect.line - 1]


@pytest.mark.parametrize("text", [OWN, SEEDED])
def test_a_draw_from_a_generator_that_the_file_seeds_is_not_read(text: str) -> None:
    assert not [*generators(Program(parse(text), "Corridor"))]


@installed
def test_a_draw_is_reported_as_one() -> None:
    report = envcraft.validate(GAME, contract="gymnasium", sandbox="process", budget="quick", checks="determinism,lint")
    (finding,) = [finding for check in report.reports[0].checks for finding in check.findings]
    assert finding.code == "EC204"
    assert finding.line == GAME.splitlines().index("        slips = torch.rand(1) < 0.3") + 1
    assert finding.message.endswith("takes a number that no seed of reset() controls: torch.rand()")


@installed
def test_a_generator_of_its_own_passes() -> None:
    report = envcraft.validate(OWN, contract="gymnasium", sandbox="process", budget="quick", checks="determinism,lint")
    assert not [finding for check in report.reports[0].checks for finding in check.findings]
