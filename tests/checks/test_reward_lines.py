"""A finding about the reward names the line that writes it, if there is one."""

from __future__ import annotations

from pathlib import Path

import pytest
from envcraft_checks.rewards.blame import reward_line

import envcraft
from tests.envcraft.conftest import ENVIRONMENT

_HEAD = "class Game:\n    def __init__(self):\n        self.pay = 0.0\n\n    def step(self, action):\n"
_END = "        return 0, {}, False, False, {{}}\n"


@pytest.mark.parametrize(
    ("body", "reward", "line"),
    [
        ("        reward = 0.0\n        if action:\n            reward += 1000\n", "reward", 8),
        ("        reward = 0.0\n        if action:\n            reward += 1000\n", "float(reward)", 8),
        ("        reward = 0.0\n", "reward", 6),
        ("        (reward := 5)\n", "reward", 6),
        ("        hits, reward = action\n", "reward", 6),
        ("        self.pay = 9\n", "self.pay", 6),
        ("        pass\n", "9.0 * action", 7),
        # Several lines write these, or what writes them is elsewhere.
        ("        reward = 1\n        reward += 1000\n", "reward", None),
        ("        for reward in range(3): pass\n", "reward", None),
        ("        pass\n", "action", None),
        ("        pass\n", "reward", None),
        ("        if action:\n            return 0, 5, True, False, {}\n", "7", None),
        ("        if action:\n            return self.end()\n", "7", None),
    ],
)
def test_the_only_line_that_writes_the_reward(body: str, reward: str, line: int | None) -> None:
    assert reward_line(_HEAD + body + _END.format(reward), "Game") == line


def test_a_class_without_a_step_of_its_own_has_no_line() -> None:
    assert reward_line("class Game: pass\n", "Game") is None
    assert reward_line("class Game(:\n", "Game") is None
    assert reward_line(_HEAD + _END.format("9.0"), "Other") is None


def test_a_finding_names_the_line(tmp_path: Path) -> None:
    file = tmp_path / "walk.py"
    file.write_text(
        ENVIRONMENT.replace(
            "        return self.render(), float(won)", "        pay = 1e6\n        return self.render(), pay"
        )
    )
    report = envcraft.validate(file, sandbox="process", budget="quick", checks="reward")
    [found] = [finding for check in report.reports[0].checks for finding in check.findings if finding.code == "EC303"]
    assert file.read_text().splitlines()[(found.line or 0) - 1].strip() == "pay = 1e6"
