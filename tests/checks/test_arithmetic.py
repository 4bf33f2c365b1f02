"""What NumPy warns about in an earlier episode has that episode as its reproduction."""

from __future__ import annotations

import envcraft

GAME = """
import gymnasium as gym
import numpy as np
class Game(gym.Env):
    observation_space = gym.spaces.Box(0, 255, (8,), np.uint8)
    action_space = gym.spaces.Discrete(2)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.glow = 0, 0
        self.rare = self.np_random.random() < 0.05
        return self.see(), {}
    def step(self, action):
        self.steps += 1
        self.glow = 20 if self.rare and self.steps == 3 else 0
        return self.see(), float(action), self.steps >= 30, False, {}
    def see(self):
        cells = np.full(8, 240, np.uint8)
        cells[1] = self.steps
        cells[0] += np.uint8(self.glow)
        return cells
"""


def test_a_warning_of_an_earlier_episode() -> None:
    report = envcraft.validate(GAME, contract="gymnasium", sandbox="process")
    findings = [finding for check in report.reports[0].checks for finding in check.findings]
    [found] = [finding for finding in findings if finding.code == "EC914"]
    assert found.evidence["step"] == 3
    assert len(found.repro.actions) == 3
    assert not found.repro.conditions
