"""EC305 is a warning, so no fixture's header expects it: a win that pays nothing, and games that resemble one."""

from __future__ import annotations

import pytest
from envcraft_checks.reward import Reward
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE, GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.contract import Contract
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import SubjectReport
from evaluation.fixtures import FIXTURES

GAME = (FIXTURES / "termination" / "good" / "torch_burns_out.py").read_text()
REWARD = "reward = 4.0 if won else -1.0 if lost else 0.0"
REWARDS = {
    REWARD: "",
    # No play is paid at all.
    "reward = 0.0": "EC306",
    "reward = 0.0 * self.steps if won else 0.0 * action[1]": "EC306",
    "reward = -self.steps * 0.5 + self.steps / 2": "EC305",
    "reward = -10.0 if won else 0.0": "EC305",
    # A cost of time: a win ends it sooner.
    "reward = -0.1": "",
    "reward = 1.0 if won else -1.0": "",
    # The best is not to lose, and idling loses.
    "reward = -1.0 if lost else 0.0": "",
    # Idling wins.
    "won, lost = self.steps >= TORCH, self.player in self.pits; reward = -float(lost)": "",
}


#: Under a contract without an action that does nothing.
WITHOUT_NOOP = {
    REWARD: "",
    "reward = 0.0": "EC305",
    # The win is unpaid, but losing is not.
    "reward = -1.0 if lost else 0.0": "",
    "reward = 0.1 if won else 0.0": "",
    # No success is reported.
    "reward, won = 0.0, False": "EC306",
}


def _judged(rewards: dict[str, str], contract: Contract) -> dict[str, SubjectReport]:
    """The report on the game with each reward."""
    assert REWARD in GAME
    targets = [Target("game.py", GAME.replace(REWARD, reward).encode()) for reward in rewards]
    plan = Plan(targets, contract, driver_named("process"), [Source(), Reward()], BUDGETS["quick"])
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    return dict(zip(rewards, last.report.reports, strict=True))


def _codes(report: SubjectReport) -> set[str]:
    return {finding.code for check in report.checks for finding in check.findings}


@pytest.fixture(scope="module")
def reports() -> dict[str, SubjectReport]:
    return _judged(REWARDS, ARCADE)


@pytest.fixture(scope="module")
def reports_without_noop() -> dict[str, SubjectReport]:
    return _judged(WITHOUT_NOOP, GYMNASIUM)


@pytest.mark.parametrize(("reward", "code"), REWARDS.items())
def test_unpaid_wins(reward: str, code: str, reports: dict[str, SubjectReport]) -> None:
    assert _codes(reports[reward]) == ({code} if code else set())


@pytest.mark.parametrize(("reward", "code"), WITHOUT_NOOP.items())
def test_unpaid_wins_without_noop(reward: str, code: str, reports_without_noop: dict[str, SubjectReport]) -> None:
    assert _codes(reports_without_noop[reward]) == ({code} if code else set())
