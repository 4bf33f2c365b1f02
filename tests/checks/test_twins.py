"""EC408 is a warning, so no header expects it: left and right that do the same, and games that resemble them."""

from __future__ import annotations

import pytest
from envcraft_checks.observation import Observation
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, Severity
from evaluation.fixtures import FIXTURES

GOOD = FIXTURES / "observation" / "good"
FLAP = "-2.5 if action[0] else"
LANE = "self.lane = 1 - self.lane"
TURN = "self.lamp = (self.lamp + 1) % BEAMS"


def judged(name: str, line: str, other: str) -> list[Finding]:
    """The findings on a fixture in which something else stands in place of `line`."""
    source = (GOOD / name).read_text()
    assert line in source
    target = Target("game.py", source.replace(line, other).encode())
    plan = Plan([target], ARCADE, driver_named("process"), [Source(), Observation()], BUDGETS["quick"])
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    return [finding for check in last.report.reports[0].checks for finding in check.findings]


@pytest.mark.parametrize(
    ("name", "line", "other"),
    [
        ("any_arrow_flaps.py", FLAP, "-2.5 if action[0] in (3, 4) else"),
        ("change_the_lane.py", LANE, "self.lane = 1"),
        ("both_arrows_turn_right.py", TURN, "self.lamp = max(self.lamp - 1, 0)"),
    ],
)
def test_left_and_right_that_do_the_same(name: str, line: str, other: str) -> None:
    (finding,) = judged(name, line, other)
    assert (finding.code, finding.severity) == ("EC408", Severity.WARNING)
    assert finding.evidence["moves"] == [3, 4]
    assert finding.evidence["episodes"] >= 2
    assert finding.repro is not None
    assert finding.repro.actions[0] == [3, 0, 0]


@pytest.mark.parametrize(
    ("name", "line", "other"),
    [
        ("any_arrow_flaps.py", FLAP, "-2.5 if action[0] == 1 else"),
        # Up and down may do the same on purpose.
        ("any_arrow_flaps.py", FLAP, "-2.5 if action[0] in (1, 2) else"),
        ("change_the_lane.py", LANE, LANE),
        ("both_arrows_turn_right.py", TURN, "self.lamp = (self.lamp + (1 if move == 4 else -1)) % BEAMS"),
        # The moves differ in a rare state only: where the lamp meets the ship.
        ("both_arrows_turn_right.py", TURN, f"{TURN}; self.saved += self.lamp == self.ship and move == 3"),
    ],
)
def test_moves_that_differ_undo_themselves_or_do_nothing(name: str, line: str, other: str) -> None:
    assert judged(name, line, other) == []
