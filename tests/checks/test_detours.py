"""A search that is paid at each step comes to a success late: the check reward then leaves out its detours."""

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
from envcraft.model.verdict import Finding
from evaluation.fixtures import FIXTURES

GAME = (FIXTURES / "reward" / "bad" / "wages_of_the_mole.py").read_text()
WAGE = "WAGE = 0.1"
#: A day has 300 steps; all carrots and the way home pay 5.
DAY, HOME = 300, 5.0


def judged(wage: str) -> list[Finding]:
    """The findings on the game with this wage."""
    assert WAGE in GAME
    source = GAME.replace(WAGE, wage)
    plan = Plan(
        [Target("game.py", source.encode())], ARCADE, driver_named("process"), [Source(), Reward()], BUDGETS["quick"]
    )
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    return [finding for check in last.report.reports[0].checks for finding in check.findings]


def test_waiting_is_compared_with_a_success_without_detours() -> None:
    (finding,) = judged(WAGE)
    assert finding.code == "EC308"
    assert finding.evidence["earned"] == pytest.approx(0.1 * DAY)
    # The search itself needs most of the day, so its success is paid as much.
    assert HOME < finding.evidence["success"] < HOME + 0.1 * DAY / 4


def test_a_wage_below_the_prize_is_fine() -> None:
    assert judged("WAGE = 0.01") == []
