"""What differs without a render mode, and the line that a finding about it names."""

from __future__ import annotations

import pytest

import envcraft

GAME = """
import gymnasium as gym
import numpy as np
class Game(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}
    observation_space = gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = gym.spaces.MultiDiscrete([5, 2, 2])
    def __init__(self, render_mode={default}):
        {constructor}
        self.render_mode = render_mode
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = int(self.np_random.integers(9)), 0
        return self._frame(), {{}}
    def step(self, action):
        self.steps += 1
        self.at = (self.at + int(action[0])) % 84
        return self._frame(), float(self.at == 80), self.at == 80, self.steps >= 99, {{}}
    def _frame(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[:, self.at] = 255
        {frame}
        return frame
    def render(self):
        return self._frame()
"""


def found(frame: str = "pass", default: str = "None", constructor: str = "pass") -> list[tuple[str, str]]:
    """The lines and messages of EC219."""
    source = GAME.format(frame=frame, default=default, constructor=constructor)
    report = envcraft.validate(source, checks="determinism", sandbox="process", budget="quick")
    lines = ["", *source.splitlines()]
    return [
        (lines[finding.line or 0].strip(), finding.message)
        for check in report.reports[0].checks
        for finding in check.findings
        if finding.code == "EC219"
    ]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"frame": "if self.render_mode is None: return None"}, "the observation differs at the reset"),
        ({"frame": "if not self.render_mode: frame = frame * 0"}, "first at [0, 7] ([255, 255, 255], then ["),
        ({"frame": "self.metadata['render_modes'].index(self.render_mode)"}, "reset() raises ValueError"),
        ({"constructor": "assert render_mode in self.metadata['render_modes']"}, "the constructor raises Asser"),
    ],
)
def test_play_that_needs_a_render_mode(given: dict[str, str], words: str) -> None:
    [(line, message)] = found(**given)
    assert line in given.values()
    assert message.startswith("without a render mode, the default, ")
    assert words in message


@pytest.mark.parametrize(
    "given",
    [
        {},
        {"default": "'rgb_array'", "frame": "if not self.render_mode: return None"},
        {"constructor": "assert render_mode in (None, 'rgb_array')"},
        {"frame": "if self.render_mode == 'human': frame[:] = 9"},
    ],
)
def test_play_that_does_not(given: dict[str, str]) -> None:
    assert not found(**given)
