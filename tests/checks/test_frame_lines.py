"""The line that is named where a picture is made before the game changes."""

from __future__ import annotations

import pytest
from envcraft_checks.pictures.drawing import frame_line

from envcraft.model.target import Target
from tests.checks.lint_games import subject_of

GAME = """
class Game:
    def step(self, action):
        {first}
        self.at += 1
        {last}
        return {result}, 0.0, False, False, {{}}
    def reset(self):
        return self.render(), {{}}
"""


@pytest.mark.parametrize(
    ("first", "last", "result", "line"),
    [
        ("frame = self.render()", "pass", "frame", 4),
        ("pass", "frame = self.render()", "frame", None),
        ("pass", "pass", "self.render()", None),
        ("frame = self.render()", "frame = self.render()", "frame", None),
    ],
)
def test_a_frame_that_step_makes_too_early(first: str, last: str, result: str, line: int | None) -> None:
    text = GAME.format(first=first, last=last, result=result)
    with subject_of(Target("game.py", text.encode())) as subject:
        assert frame_line(subject) == line
