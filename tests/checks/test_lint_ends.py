"""What the check lint reports about the end of an episode: numbers that a count skips, a limit that is not the declared
one, lists that are compared in part, and rewards that come too late.
"""

from __future__ import annotations

import ast

import pytest
from envcraft_checks.linting.limits import other_limits
from envcraft_checks.linting.owed import owed_rewards
from envcraft_checks.linting.pairs import short_comparisons
from envcraft_checks.linting.program import Program, Suspect
from envcraft_checks.linting.skipped import skipped_numbers

GAME = """
import gymnasium as gym
BOUND = 600
class Rat:
    def __init__(self, large):
        self.hearts = 2 if large else 1
        self.bite = 2 if large else 1
class Game(gym.Env):
    MAX_STEPS = 800
    step_length = 3
    def __init__(self):
        self.horizon = 400
    def reset(self, *, seed=None, options=None):
        self.hearts, self.score, self.age, self.due = 9, 0, 0, 0.0
        self.notes, self.melody, self.rat = [], [1, 2], Rat(seed)
        return self.show(), {}
    def step(self, action):
        reward = 0.0
        self.age += 1
        won = self.score >= 10
        %s
        return self.show(), reward, won or self.hearts <= 0, self.age >= self.MAX_STEPS, {}
    def show(self):
        return %s
"""


def program(step: str, ends: str | None = None, limit: str | None = None, show: str = "self.age") -> Program:
    """A game with these statements in step(), these tests of the end, and this observation."""
    text = GAME % (step.replace("\n", "\n        "), show)
    if ends is not None:
        text = text.replace("won or self.hearts <= 0", ends)
    if limit is not None:
        text = text.replace("self.age >= self.MAX_STEPS", limit)
    return Program(ast.parse(text))


def line(suspect: Suspect, game: Program) -> str:
    """The text of the line that a rule reports."""
    return next(ast.unparse(one) for one in game.nodes if isinstance(one, ast.stmt) and one.lineno == suspect.line)


@pytest.mark.parametrize(
    ("step", "certain"),
    [
        ("self.hearts -= self.rat.bite", True),
        ("self.hearts -= 2", True),
        ("self.hearts = self.hearts - (2 if action else 1)", True),
        ("damage = 4 if action else 3\nself.hearts -= damage", True),
        ("self.hearts -= 2 if action == 1 else 1\nif action == 2: self.hearts += 1", False),
    ],
)
def test_a_count_may_skip_the_number(step: str, certain: bool) -> None:
    game = program(step, ends="won or self.hearts == 0")
    [suspect] = skipped_numbers(game)
    assert suspect.certain is certain
    assert "self.hearts == 0" in suspect.words
    assert "self.hearts == 0" in line(suspect, game)


@pytest.mark.parametrize(
    ("step", "ends"),
    [
        ("self.hearts -= 3", "won or self.hearts == 0"),
        ("self.hearts -= 1", "won or self.hearts == 0"),
        ("self.hearts -= self.rat.bite", "won or self.hearts <= 0"),
        ("self.hearts = max(0, self.hearts - 2)", "won or self.hearts == 0"),
        ("self.hearts -= 2\nif self.hearts < 0: self.hearts = 0", "won or self.hearts == 0"),
        ("self.hearts -= min(self.hearts, self.rat.bite)", "won or self.hearts == 0"),
        ("self.rat.hearts -= 2\nself.hearts -= 1", "won or self.hearts == 0"),
        ("self.hearts -= int(action)", "won or self.hearts == 0"),
        ("self.hearts -= 2\nlost = self.hearts < 0", "won or self.hearts == 0 or lost"),
    ],
)
def test_a_count_that_meets_the_number_or_is_not_known(step: str, ends: str) -> None:
    assert not list(skipped_numbers(program(step, ends=ends)))


@pytest.mark.parametrize(
    ("limit", "show"),
    [
        ("self.age >= 500", "self.age / self.MAX_STEPS"),
        ("self.age > 500", "self.MAX_STEPS - self.age"),
        ("self.age >= 500 and not won", "self.age / self.horizon"),
    ],
)
def test_a_limit_that_is_not_the_declared_one(limit: str, show: str) -> None:
    game = program("pass", limit=limit, show=show)
    [suspect] = other_limits(game)
    assert limit.partition(" and")[0] in suspect.words
    assert suspect.words.endswith("MAX_STEPS is 800" if "MAX" in show else "horizon is 400")


@pytest.mark.parametrize(
    ("limit", "show"),
    [
        ("self.age >= 800", "self.age / self.MAX_STEPS"),
        ("self.age >= self.MAX_STEPS", "self.age / 500"),
        # Nothing uses the declared limit, so it may be a leftover.
        ("self.age >= 500", "self.age"),
        ("self.age >= BOUND", "self.age / self.MAX_STEPS"),
        # A second limit, and a number that is no limit.
        ("self.age >= 500 and not won or self.age >= self.MAX_STEPS", "self.age / self.MAX_STEPS"),
        ("self.score >= 500", "self.age / self.MAX_STEPS"),
        ("self.age >= 500", "self.age / self.step_length"),
    ],
)
def test_a_limit_that_the_code_declares(limit: str, show: str) -> None:
    assert not list(other_limits(program("pass", limit=limit, show=show)))


EQUAL = "all(a == b for a, b in zip(self.notes, self.melody))"


def test_a_comparison_of_pairs_takes_an_empty_list_for_equal() -> None:
    game = program(f"self.notes.append(action)\nif {EQUAL}: self.score += 1\nself.notes = []")
    [suspect] = short_comparisons(game)
    assert "an empty self.notes is equal to any list" in suspect.words


@pytest.mark.parametrize(
    "step",
    [
        f"self.notes.append(action)\nif len(self.notes) == 2 and {EQUAL}: self.score += 1\nself.notes = []",
        f"self.notes.append(action)\nif self.notes and {EQUAL}: self.score += 1\nself.notes = []",
        f"self.notes.append(action)\nif not self.notes: return\nif {EQUAL}: self.score += 1",
        "self.notes.append(action)\nif all(a == b for a, b in zip(self.notes, self.melody, strict=True)): won = True",
        # Nothing empties or fills it.
        f"if {EQUAL}: self.score += 1",
        "self.notes.append(action)\nclose = any(a == b for a, b in zip(self.notes, self.melody))",
    ],
)
def test_a_comparison_of_pairs_whose_number_is_known(step: str) -> None:
    assert not list(short_comparisons(program(step)))


@pytest.mark.parametrize(
    ("step", "late"),
    [
        ("reward, self.due = self.due, 0.0\nif won:\n    self.due += 4.0", "self.due += 4.0"),
        ("reward += self.due\nself.due = 0.0\nif won and action:\n    self.due = 4.0", "self.due = 4.0"),
        ("reward = self.due\nif self.hearts <= 0:\n    self.due -= 4.0", "self.due -= 4.0"),
        ("reward = self.due\nif self.age > 9:\n    won = True\n    self.due = 2", "self.due = 2"),
    ],
)
def test_a_reward_that_comes_after_the_last_step(step: str, late: str) -> None:
    game = program(step)
    [suspect] = owed_rewards(game)
    assert line(suspect, game) == late


@pytest.mark.parametrize(
    "step",
    [
        # Paid in this step.
        "self.due = 0.0\nif won:\n    self.due += 4.0\nreward = self.due",
        "reward = self.due\nif won:\n    self.due += 4.0\n    reward += 4.0",
        "reward = self.due\nif won:\n    self.due += 4.0\nreward += self.due",
        # The episode goes on, and the next step pays.
        "reward, self.due = self.due, 0.0\nif action:\n    self.due += 0.1",
        "reward, self.due = self.due, 0.0\nif not won:\n    self.due += 0.1",
        "reward, self.due = self.due, 0.0\nif won or action:\n    self.due += 0.1",
        # Cleared for the next episode.
        "reward = self.due\nif won:\n    self.due = 0.0",
    ],
)
def test_a_reward_that_a_step_pays(step: str) -> None:
    assert not list(owed_rewards(program(step)))
