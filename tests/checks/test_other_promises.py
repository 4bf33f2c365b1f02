"""Rules that are errors under ``arcade`` warn where a contract promises less, and pass what it allows."""

from __future__ import annotations

import pytest
from envcraft_checks.observation import Observation
from envcraft_checks.reward import Reward
from envcraft_checks.source import Source

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Severity, SubjectReport
from evaluation.fixtures import FIXTURES

FAINT = (FIXTURES / "observation" / "bad" / "ec405_unscaled_floats.py").read_text()
CODES = (FIXTURES / "observation" / "bad" / "ec405_tile_codes.py").read_text()
UNPAID = (FIXTURES / "reward" / "bad" / "never_pays.py").read_text()
GAMES = {
    FAINT: {"EC405"},
    UNPAID: {"EC306"},
    # Pictures of codes: without channels, and with one code for each cell.
    CODES.replace("(N * PX, N * PX, 3)", "(N * PX, N * PX)").replace(
        "np.stack([picture] * 3, axis=-1)", "picture"
    ): set(),
    CODES.replace("N, PX = 12, 7", "N, PX = 12, 1"): set(),
}


@pytest.fixture(scope="module")
def reports() -> dict[str, SubjectReport]:
    """The report on each game."""
    assert len(GAMES) == len({*GAMES, CODES}) - 1
    targets = [Target("game.py", game.encode()) for game in GAMES]
    checks = [Source(), Observation(), Reward()]
    *_, last = validate(Plan(targets, GYMNASIUM, driver_named("process"), checks, BUDGETS["quick"]))
    assert isinstance(last, Finished)
    return dict(zip(GAMES, last.report.reports, strict=True))


@pytest.mark.parametrize("game", GAMES, ids=["faint", "unpaid", "codes", "small"])
def test_findings_are_warnings(game: str, reports: dict[str, SubjectReport]) -> None:
    found = [finding for check in reports[game].checks for finding in check.findings]
    assert {finding.code for finding in found} == GAMES[game]
    assert all(finding.severity is Severity.WARNING for finding in found)
