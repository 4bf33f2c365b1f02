"""EC305 is a warning, so no fixture's header expects it: a win without a reward, and games that resemble one."""

from __future__ import annotations

import pytest
from envcraft_checks.reward import Reward
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import SubjectReport
from evaluation.fixtures import FIXTURES

GAME = (FIXTURES / "termination" / "good" / "torch_burns_out.py").read_text()
REWARD = "reward = 4.0 if won else -1.0 if lost else 0.0"
REWARDS = {
    REWARD: False,
    "reward = 0.0": True,
    "reward = -10.0 if won else 0.0": True,
    # A cost of time: a win ends it sooner.
    "reward = -0.1": False,
    "reward = 1.0 if won else -1.0": False,
    # The best is not to lose, and idling loses.
    "reward = -1.0 if lost else 0.0": False,
    # Idling wins.
    "won, lost = self.steps >= TORCH, self.player in self.pits; reward = -float(lost)": False,
}


@pytest.fixture(scope="module")
def reports() -> dict[str, SubjectReport]:
    """The report on the game with each reward."""
    assert REWARD in GAME
    targets = [Target("game.py", GAME.replace(REWARD, reward).encode()) for reward in REWARDS]
    plan = Plan(targets, ARCADE, driver_named("process"), [Source(), Reward()], BUDGETS["quick"])
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    return dict(zip(REWARDS, last.report.reports, strict=True))


@pytest.mark.parametrize(("reward", "unpaid"), REWARDS.items())
def test_unpaid_wins(reward: str, unpaid: bool, reports: dict[str, SubjectReport]) -> None:
    codes = {finding.code for check in reports[reward].checks for finding in check.findings}
    assert codes == ({"EC305"} if unpaid else set())
