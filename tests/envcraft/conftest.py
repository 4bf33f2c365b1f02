"""What the framework's tests share: an environment that passes, and the command line in this process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from envcraft.cli.group import cli

ENVIRONMENT = '''"""A walk along a line: seven steps to the right win."""

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Walk(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x, self.steps, self.goal = 5, 0, int(self.np_random.integers(9, 12))
        return self.render(), {}

    def step(self, action):
        self.steps += 1
        self.x = max(self.x + {3: -1, 4: 1}.get(int(action[0]), 0), 0)
        won = self.x >= self.goal
        return self.render(), float(won), won, self.steps >= 100, {"is_success": won}

    def render(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[40:44, self.goal * 6 : self.goal * 6 + 6] = 90
        frame[40:44, self.x * 6 : self.x * 6 + 6] = 255
        return frame
'''

Invoke = Callable[..., Result]


@pytest.fixture
def invoke(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Invoke:
    """Run the command line in an empty folder without a configuration."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("envcraft.registry._warned", set())

    def run(*arguments: str | Path) -> Result:
        return CliRunner().invoke(cli, [str(argument) for argument in arguments])

    return run


@pytest.fixture
def good(tmp_path: Path) -> Path:
    """A file whose environment can be loaded."""
    path = tmp_path / "walk.py"
    path.write_text(ENVIRONMENT)
    return path


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    """A file with an import that there is not."""
    path = tmp_path / "bad.py"
    path.write_text("import gymnasium\nimport nunpy\n\nclass Bad(gymnasium.Env):\n    pass\n")
    return path
