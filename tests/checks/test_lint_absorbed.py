"""What the check lint reports about ends of the episode that the code lists, and that never end it."""

from __future__ import annotations

import ast

import pytest
from envcraft_checks.linting.absorbed import absorbed_ends
from envcraft_checks.linting.program import Program

GAME = """
import gymnasium as gym
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.hearts, self.steps, self.won, self.lost = 0, 3, 0, False, False
        return self.at, {}
    def step(self, action):
        self.steps += 1
        self.at += int(action)
        won = self.at == 9
        lost = self.hearts <= 0
        over = %s
        truncated = self.steps >= 99 and not over
        return self.look(), 0.0, %s, truncated, self.info()
    def look(self):
        return self.at
    def info(self):
        return {"is_success": self.won}
"""


def reports(over: str, flag: str, look: str = "return self.at") -> list[str]:
    """What the rule says of a game with these tests of the end, and this drawing method."""
    text = GAME % (over, flag)
    return [one.words for one in absorbed_ends(Program(ast.parse(text.replace("return self.at\n", f"{look}\n"))))]


@pytest.mark.parametrize(
    ("over", "flag", "idle"),
    [
        ("won or lost", "over and won", "self.hearts <= 0"),
        ("won or lost", "(over) and bool(won)", "self.hearts <= 0"),
        ("self.won or self.lost", "over and self.won", "self.lost"),
        ("self.won or self.at < 0", "over and self.won", "self.at < 0"),
        ("won or lost", "over and not won", "self.at == 9"),
        ("self.won or self.lost", "(over) and not (self.won)", "self.won"),
        ("0", "won and (won or lost)", "self.hearts <= 0"),
    ],
)
def test_an_end_that_never_ends(over: str, flag: str, idle: str) -> None:
    assert reports(over, flag) == [f"lists {idle} as an end, which never makes terminated true"]


@pytest.mark.parametrize(
    ("over", "flag"),
    [
        ("won", "over and not won"),
        ("not len(self.items)", "over and not (not len(self.items))"),
        ("self.won", "over and not self.won"),
    ],
)
def test_a_flag_that_is_never_true(over: str, flag: str) -> None:
    [words] = reports(over, flag)
    assert words.startswith("returns over and (not ")
    assert words.endswith(" as terminated, which is never true")


@pytest.mark.parametrize(
    ("over", "flag"),
    [
        ("won or lost", "over"),
        ("won or lost", "over and self.steps > 1"),
        ("won or (won and lost)", "over"),
        ("won", "over"),
        ("won and lost", "over and won"),
        # Two calls need not say the same.
        ("self.is_won() or lost", "over and self.is_won()"),
    ],
)
def test_an_end_that_may_end(over: str, flag: str) -> None:
    assert not reports(over, flag)


def test_a_flag_that_changes_in_between() -> None:
    assert not reports("self.won or self.lost", "over and self.won", "self.won = self.lost\n        return self.at")
