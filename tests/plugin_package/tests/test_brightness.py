"""Each game is judged as its first line says: `expect` names the codes, a near miss has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from envcraft.model.verdict import Verdict
from envcraft.pytest_plugin.fixture import EnvCraft

GAMES = Path(__file__).parent / "games"


@pytest.mark.parametrize("path", sorted(GAMES.glob("bad/*.py")), ids=lambda path: path.stem)
def test_found(envcraft: EnvCraft, path: Path) -> None:
    report = envcraft.judge(path, checks="brightness")
    (found,) = [finding for check in report.checks for finding in check.findings]
    assert f"# expect: {found.code}\n" == path.read_text().splitlines(keepends=True)[0]
    assert found.evidence["rate"]["low"] > 0.5


@pytest.mark.parametrize("path", sorted(GAMES.glob("good/*.py")), ids=lambda path: path.stem)
def test_near_misses_pass_every_check(envcraft: EnvCraft, path: Path) -> None:
    report = envcraft.check(path, budget="quick")
    assert {check.check: check.verdict for check in report.checks}["brightness"] is Verdict.PASS


def test_what_shows_no_picture_is_not_judged(envcraft: EnvCraft) -> None:
    report = envcraft.judge("CartPole-v1", checks="brightness", contract="gymnasium")
    (judged,) = [check for check in report.checks if check.check == "brightness"]
    assert (judged.verdict, judged.reason) == (Verdict.SKIP, "its observations are not pictures")
