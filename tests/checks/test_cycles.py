"""Loops that pay where no play succeeds, and when they lead back to the same state."""

from __future__ import annotations

import pytest
from envcraft_checks.reward import Reward
from envcraft_checks.rewards.cycles import _are_alike
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, Severity, Verdict
from evaluation.fixtures import FIXTURES

#: A skater with momentum, who is paid for crossing a line upwards.
SKATER = (FIXTURES / "reward" / "bad" / "skater_at_the_line.py").read_text()
CROSSED = "0.4 if self.place[1] < self.LINE <= before else 0.0"


def judged(source: str) -> list[Finding]:
    plan = Plan(
        [Target("game.py", source.encode())], ARCADE, driver_named("process"), [Source(), Reward()], BUDGETS["standard"]
    )
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    checks = last.report.reports[0].checks
    assert not [check.reason for check in checks if check.verdict is Verdict.ERROR]
    return [finding for check in checks for finding in check.findings]


def test_two_moves_in_turn_pay_on_and_on() -> None:
    (finding,) = judged(SKATER)
    assert (finding.code, finding.severity) == ("EC307", Severity.ERROR)
    assert finding.evidence["gain"] == pytest.approx(0.4)
    assert len(finding.evidence["loop"]) == 12


def test_a_game_whose_first_step_raises_under_most_actions() -> None:
    step = "    def step(self, action):\n"
    assert step in SKATER
    raises = f"{step}        if self.ticks == 0 and list(action) != [1, 0, 0]:\n            raise ValueError(action)\n"
    paid = SKATER.replace(step, raises).replace(CROSSED, "0.1")
    assert {finding.code for finding in judged(paid)} <= {"EC307"}


@pytest.mark.parametrize(
    "change",
    [
        # The way back costs as much.
        (CROSSED, "0.4 * ((self.place[1] < self.LINE <= before) - (before < self.LINE <= self.place[1]))"),
        # The environment counts what is paid, so something is reached.
        (CROSSED, f"{CROSSED}\n        self.laps = getattr(self, 'laps', 0.0) + reward"),
        # Idling is paid as well.
        (CROSSED, "0.4"),
    ],
)
def test_a_loop_that_costs_counts_or_pays_as_idling_does_is_fine(change: tuple[str, str]) -> None:
    assert CROSSED in SKATER
    assert judged(SKATER.replace(*change)) == []


@pytest.mark.parametrize(
    ("path", "texts", "alike"),
    [
        ("self.ticks", ["4", "8", "12"], True),
        ("self.time_left", ["9.5", "9.25", "9.0"], True),
        ("self.coins", ["1", "2", "3"], False),
        ("self.place", ["4.5", "4.501", "4.5015"], True),
        ("self.place", ["4.5", "4.51", "4.52"], False),
        ("self.name", ["'a'", "'b'", "'c'"], False),
        ("self.frame", ["an array of uint8 (84, 84, 3)"] * 3, True),
        ("self.np_random", [""] * 3, False),
    ],
)
def test_only_time_may_differ(path: str, texts: list[str], alike: bool) -> None:
    states = [{path: (str(number), text)} for number, text in enumerate(texts)]
    assert _are_alike(states, size=4) is alike
