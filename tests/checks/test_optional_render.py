"""Where a contract makes render() optional, a missing one is fine, and one that is there is judged."""

from __future__ import annotations

import pytest

from envcraft.contracts.builtin import ARCADE, ARCADE_NATIVE, GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named, select_checks
from envcraft.model.contract import Contract
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, Severity

GAME = """
import gymnasium as gym
import numpy as np


class Lamp(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        self.render_mode = render_mode
        self.observation_space = gym.spaces.Box(0, 255, (SIDE, SIDE, 3), np.uint8)
        self.action_space = gym.spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = int(self.np_random.integers(20)), 0
        return self._frame(), {}

    def step(self, action):
        self.at = (self.at + int(action[0]) - 2) % 84
        self.steps += 1
        return self._frame(), 0.0, False, self.steps >= 1000, {}

    def _frame(self):
        frame = np.zeros((SIDE, SIDE, 3), np.uint8)
        frame[:, self.at] = 255
        return frame
"""
NEGATIVE = "    def render(self):\n        return 255 - self._frame()\n"
BROKEN = "    def render(self):\n        return self.screen\n"
SAME = "    def render(self):\n        return self._frame()\n"


@pytest.mark.parametrize("side", [84, 160])
@pytest.mark.parametrize(("render", "codes"), [("", set()), (SAME, set()), (NEGATIVE, {"EC404"}), (BROKEN, {"EC112"})])
def test_optional_render(side: int, render: str, codes: set[str]) -> None:
    assert codes_of(ARCADE_NATIVE, GAME.replace("SIDE", str(side)) + render) == codes


def test_required_render_is_missed() -> None:
    assert "EC112" in codes_of(ARCADE, GAME.replace("SIDE", "84"))


@pytest.mark.parametrize(
    ("frame", "shown", "severity"),
    [
        ("np.zeros((12, 12, 3))", "a float64 array of shape (12, 12, 3)", Severity.WARNING),
        ("np.zeros((12, 12, 4), np.uint8)", "a uint8 array of shape (12, 12, 4)", Severity.WARNING),
        ("np.zeros((12, 12), np.uint8)", "a uint8 array of shape (12, 12)", Severity.ERROR),
        ("[[0]]", "nested Python lists of shape (1, 1)", Severity.ERROR),
        ("np.zeros((12, 12, 3), np.uint8)", "", None),
    ],
)
def test_a_frame_is_what_gymnasium_expects(frame: str, shown: str, severity: Severity | None) -> None:
    source = GAME.replace("SIDE", "84") + f"    def render(self):\n        return {frame}\n"
    found = [finding for finding in _findings(GYMNASIUM, source, "api") if finding.code == "EC112"]
    assert [finding.message.partition(", not ")[0] for finding in found] == (
        [f"render() returned {shown}"] if shown else []
    )
    assert [finding.severity for finding in found] == ([severity] if severity else [])


@pytest.mark.parametrize(
    ("render", "code", "named"),
    [
        ("return self._frame() if self.render_mode else None", "EC112", "not a frame: "),
        ("return self._frame()", "EC116", ""),
    ],
)
def test_a_lost_mode_is_named_once(render: str, code: str, named: str) -> None:
    source = GAME.replace("SIDE", "84").replace("self.render_mode = render_mode", "pass")
    [found] = _findings(GYMNASIUM, f"{source}    def render(self):\n        {render}\n", "api")
    words = f"{named}the constructor receives render_mode='rgb_array', but then render_mode is None"
    assert (found.code, words in found.message) == (code, True)
    assert source.splitlines()[(found.line or 0) - 1].strip().startswith("def __init__")


def codes_of(contract: Contract, source: str) -> set[str]:
    return {finding.code for finding in _findings(contract, source, "api,observation")}


def _findings(contract: Contract, source: str, names: str) -> list[Finding]:
    checks = select_checks(names, None)
    plan = Plan([Target("lamp.py", source.encode())], contract, driver_named("process"), checks, BUDGETS["quick"])
    *_, last = validate(plan, 1)
    assert isinstance(last, Finished)
    return [finding for check in last.report.reports[0].checks for finding in check.findings]
