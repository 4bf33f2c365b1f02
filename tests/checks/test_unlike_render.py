"""A picture that stops at an event of a short game differs from render(), in the best episode if not in random play."""

from __future__ import annotations

from pathlib import Path

import pytest

import envcraft

GAME = Path(__file__).resolve().parents[1] / "fixtures" / "termination" / "good" / "short_rounds.py"
FREEZE = """
    def _picture(self):
        if self.hits == 0:
            self.still = self._frame()
        return self.still.copy()
"""


@pytest.mark.parametrize("seed", [2, 44])
def test_a_picture_that_stops_at_the_first_hit(seed: int) -> None:
    step = "return self._frame(), reward"
    text = GAME.read_text()
    assert text.count(step) == 1
    report = envcraft.validate(
        text.replace(step, "return self._picture(), reward") + FREEZE, seed=seed, checks=["observation"]
    )
    assert [finding.code for check in report.reports[0].checks for finding in check.findings] == ["EC404"]
