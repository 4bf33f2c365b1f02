"""One defect of the picture is reported once."""

from __future__ import annotations

from pathlib import Path

import pytest

import envcraft

GAME = (Path(__file__).resolve().parents[1] / "fixtures" / "termination" / "good" / "short_rounds.py").read_text()


@pytest.mark.parametrize(
    ("old", "new", "codes"),
    [
        ("        return image\n", "        return image.astype(np.int64)\n", ["EC108"]),
        ("if self.mole_up:\n            y", "if self.np_random.random() < 0.5:\n            y", ["EC208"]),
    ],
)
def test_one_finding(old: str, new: str, codes: list[str]) -> None:
    assert GAME.count(old) == 1
    report = envcraft.validate(GAME.replace(old, new))
    assert [finding.code for check in report.reports[0].checks for finding in check.findings] == codes
