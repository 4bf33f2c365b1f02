"""What lint says of times that outlive their clock, rows that are swapped, and tables that play writes into."""

from __future__ import annotations

import pytest

from tests.checks.lint_games import found

GAME = """
import numpy as np
import gymnasium as gym
KINDS = {{"ant": {{"speed": 1}}, "bee": {{"speed": 3}}}}
ROOMS = [[1, 0], [0, 1]]
class Gun:
    ready = 0
    def fire(self, now):
        if now < self.ready:
            return False
        self.ready = now + 9
        return True
class Game(gym.Env):
    PAUSE = 9
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = self.clock = self.level = self.row = 0
        self.gun = Gun()
        self.last = -9
        self.board = {board}
        {reset}
        return self.level, {{}}
    def step(self, action):
        self.t += 1
        self.clock += 1
        {step}
        return self.level, 0.0, False, self.t > 99, {{}}
    def after(self, upper, lower):
        {after}
"""


def codes(step: str, after: str = "pass", board: str = "np.zeros((4, 5))", reset: str = "pass") -> set[str]:
    parts = {"step": step.replace("\n", "\n        "), "after": after.replace("\n", "\n        ")}
    return found(GAME.format(**parts, board=board, reset=reset)) & {"EC053", "EC074", "EC075"}


DASH = "if action[1] and self.clock - self.last >= self.PAUSE: self.last = self.clock\n"
SHOT = "self.level += self.gun.fire(self.clock)\n"


@pytest.mark.parametrize(
    ("step", "after"),
    [
        (DASH + "if self.level: self.clock = 0", "pass"),
        (DASH + "if self.level: self.after(0, 1)", "self.clock = 0"),
        (SHOT + "if self.level: self.after(0, 1)", "self.level += 1\nself.clock = 0"),
    ],
)
def test_times_that_outlive_their_clock(step: str, after: str) -> None:
    assert codes(step, after) == {"EC075"}


@pytest.mark.parametrize(
    ("step", "after"),
    [
        (DASH, "pass"),
        (DASH.replace("clock", "t") + "if self.level: self.clock = 0", "pass"),
        (DASH + "if self.level: self.clock, self.last = 0, -9", "pass"),
        (DASH + "if self.level:\n    self.last = self.clock = 0", "pass"),
        (DASH + "if self.level: self.after(0, 1)", "self.clock = 0\nself.last = -self.PAUSE"),
        (DASH + "if self.level:\n    self.after(0, 1)\n    self.last = -9", "self.clock = 0"),
        (SHOT + "if self.level: self.after(0, 1)", "self.clock = 0\nself.gun = Gun()"),
        (SHOT + "if self.level: self.after(0, 1)", "self.clock = 0\nself.gun.ready = 0"),
        ("self.last = self.clock\nif self.level: self.clock = 0", "pass"),
        ("self.last = max(self.last, self.clock)\nif self.level: self.clock = 0", "pass"),
        ("if self.clock > self.last: self.last = self.clock\nif self.level: self.clock = 0", "pass"),
        (DASH.replace(">= self.PAUSE", "% 24 >= 6") + "if self.level: self.clock = 0", "pass"),
        (DASH.replace("if action[1] and", "if self.armed and") + "if self.level: self.clock = 0", "pass"),
        (DASH + "if self.level: self.clock = 0; setattr(self, 'last', -9)", "pass"),
        ("if self.clock != self.last: self.last = self.clock\nif self.level: self.clock = 0", "pass"),
    ],
)
def test_times_that_start_again(step: str, after: str) -> None:
    assert codes(step, after) == set()


@pytest.mark.parametrize(
    ("step", "after"),
    [
        ("self.board[0], self.board[1] = self.board[1], self.board[0]", "pass"),
        ("i = int(action[0])\nself.board[i], self.board[i - 1] = self.board[i - 1], self.board[i]", "pass"),
        ("self.board[:, 0], self.board[:, 1] = self.board[:, 1], self.board[:, 0]", "pass"),
        ("self.after(0, self.row + 1)", "self.board[upper], self.board[lower] = self.board[lower], self.board[upper]"),
    ],
)
@pytest.mark.parametrize("board", ["np.zeros((4, 5))", "np.array([[1, 2], [3, 4]])", "np.arange(9).reshape(3, 3)"])
def test_rows_that_become_the_same(step: str, after: str, board: str) -> None:
    assert codes(step, after, board) == {"EC074"}


@pytest.mark.parametrize(
    ("step", "after", "board"),
    [
        ("self.board[0], self.board[1] = self.board[1], self.board[0]", "pass", "np.zeros(9)"),
        ("self.board[0], self.board[1] = self.board[1], self.board[0]", "pass", "[[0] * 5 for _ in range(4)]"),
        ("self.board[0], self.board[1] = self.board[1].copy(), self.board[0].copy()", "pass", "np.zeros((4, 5))"),
        ("self.board[[0, 1]] = self.board[[1, 0]]", "pass", "np.zeros((4, 5))"),
        ("self.board[0, 1], self.board[1, 0] = self.board[1, 0], self.board[0, 1]", "pass", "np.zeros((4, 5))"),
        (
            "self.after((0, 1), (1, 0))",
            "self.board[upper], self.board[lower] = self.board[lower], self.board[upper]",
            "np.zeros((4, 5))",
        ),
    ],
)
def test_what_may_be_swapped(step: str, after: str, board: str) -> None:
    assert codes(step, after, board) == set()


@pytest.mark.parametrize(
    "step",
    [
        'for kind in KINDS.values(): kind["speed"] *= 2',
        'for name, kind in KINDS.items(): kind["speed"] += self.t',
        "for at, room in enumerate(ROOMS): room[0] += at",
        'kind = KINDS["ant"]\nkind["speed"] += 1',
        "room = ROOMS[self.level]\nroom.append(2)",
    ],
)
def test_items_of_a_table_of_the_module(step: str) -> None:
    assert codes(step) == {"EC053"}


@pytest.mark.parametrize(
    ("step", "reset"),
    [
        ("for kind in KINDS.values(): self.level += kind['speed']", "pass"),
        ("room = list(ROOMS[self.level])\nroom.append(2)", "pass"),
        ("room = ROOMS[self.level]\nroom = [2]\nroom.append(2)", "pass"),
        ("for room in ROOMS[:]: self.level += len(room)", "pass"),
        ("for kind in KINDS.values(): kind['speed'] *= 2", "for kind in KINDS.values(): kind['speed'] = 1"),
        ("for kind in KINDS.values(): kind['speed'] *= 2", "self.after(KINDS['ant'], KINDS['bee'])"),
        ("for kind in KINDS.values(): kind['near'] = self.t", "pass"),
    ],
)
def test_tables_that_stay(step: str, reset: str) -> None:
    assert codes(step, "for one in (upper, lower): one['speed'] = 1", reset=reset) == set()
