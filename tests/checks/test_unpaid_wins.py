"""EC305 is a warning, which no fixture's header expects: a win that pays nothing, and what only looks like one."""

from __future__ import annotations

from pathlib import Path

import pytest
from envcraft_checks.reward import Reward
from envcraft_checks.source import Source

from envcraft.budget import BUDGETS
from envcraft.contract import ARCADE
from envcraft.engine import Plan, validate
from envcraft.events import SubjectFinished
from envcraft.plugins import plugins
from envcraft.sandbox import choose
from envcraft.target import read_target

GAME = (Path(__file__).resolve().parents[1] / "fixtures" / "termination" / "good" / "torch_burns_out.py").read_text()
REWARD = "reward = 4.0 if won else -1.0 if lost else 0.0"


@pytest.mark.parametrize(
    ("reward", "unpaid"),
    [
        (REWARD, False),
        ("reward = 0.0", True),
        ("reward = -10.0 if won else 0.0", True),
        # Costs of time: less of them is what a win is for.
        ("reward = -0.1", False),
        ("reward = 1.0 if won else -1.0", False),
        # All that is to be had is not to lose, and idling loses.
        ("reward = -1.0 if lost else 0.0", False),
    ],
)
def test_unpaid_wins(tmp_path: Path, reward: str, unpaid: bool) -> None:
    assert REWARD in GAME
    path = tmp_path / "game.py"
    path.write_text(GAME.replace(REWARD, reward))
    driver = choose(plugins().collect("envcraft_sandbox_drivers"), "process")
    plan = Plan([read_target(str(path))], ARCADE, driver, [Source(), Reward()], BUDGETS["quick"])
    report = next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))
    codes = {finding.code for check in report.checks for finding in check.findings}
    assert codes == ({"EC305"} if unpaid else set())


def test_a_win_by_idling_is_not_unpaid(tmp_path: Path) -> None:
    survival = GAME.replace(REWARD, "won, lost = self.steps >= TORCH, self.player in self.pits; reward = -float(lost)")
    path = tmp_path / "game.py"
    path.write_text(survival)
    driver = choose(plugins().collect("envcraft_sandbox_drivers"), "process")
    plan = Plan([read_target(str(path))], ARCADE, driver, [Source(), Reward()], BUDGETS["quick"])
    report = next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))
    assert not [finding.code for check in report.checks for finding in check.findings]
