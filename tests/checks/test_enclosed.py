"""Seeds on which walls enclose a thing that the player must gather."""

from __future__ import annotations

from typing import Any

import pytest
from envcraft_checks.difficulty import Difficulty

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.target import Target

GAME = """
import gymnasium as gym
import numpy as np
WAYS = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
class Game(gym.Env):
    observation_space = gym.spaces.Box(0, 99, (200,), np.int64)
    action_space = gym.spaces.MultiDiscrete([5, 2])
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.walls = self.np_random.random((9, 12)) < 0.3
        self.walls[0, :] = self.walls[:, 0] = False
        self.at, self.t, self.found = (0, 0), 0, 0
        self.kite = (8, 11)
        free = [(int(y), int(x)) for y, x in np.argwhere(~self.walls) if y + x > 1]
        {placed}
        return self.see(), {{"is_success": False}}
    def step(self, action):
        self.t += 1
        down, right = WAYS[int(action[0])]
        cell = {cell}
        if 0 <= cell[0] < 9 and 0 <= cell[1] < 12 and ({passes}):
            self.at = cell
            self.row, self.col = cell
        if self.at in self.gems:
            self.gems.remove(self.at)
            self.found += 1
        {more}
        won = {won}
        return self.see(), float(won), won, self.t > 199, {{"is_success": won}}
    def dig(self, cell):
        self.walls[cell] = False
    def see(self):
        seen = np.zeros(200, np.int64)
        seen[:108], seen[108:112] = self.walls.ravel(), (*self.at, len(self.gems), self.found)
        return seen
"""
ANYWHERE = "self.gems = [free[number] for number in self.np_random.permutation(len(free))[:4]]"
ON_THE_EDGE = "self.gems = [cell for cell in free if 0 in cell][:4]"
BEHIND_A_WALL = (
    "self.walls[4, :] = True\n        self.gems = [cell for cell in free if cell[0] > 5 or cell[0] == 0][-9::2]"
)


PARTS = {
    "placed": ANYWHERE,
    "won": "not self.gems",
    "more": "pass",
    "passes": "not self.walls[cell]",
    "cell": "self.at[0] + down, self.at[1] + right",
}
#: Two attributes instead of one cell.
APART = {
    "self.at, self.t, self.found = (0, 0), 0, 0": "self.row, self.col, self.t, self.found = 0, 0, 0, 0",
    "self.at = cell": "self.row, self.col = cell",
    "self.at[0]": "self.row",
    "self.at[1]": "self.col",
    "*self.at": "self.row, self.col",
    "self.at": "(self.row, self.col)",
}


def found(apart: bool = False, **changes: str) -> Any:
    source = GAME.format(**PARTS | changes)
    for old, new in APART.items() if apart else ():
        source = source.replace(old, new)
    pool = WorkerPool(driver_named("process", probe=False))
    with Subject(Target("game.py", source.encode()), GYMNASIUM, pool.lease(), BUDGETS["standard"]) as subject:
        return Difficulty()._enclosed(subject)


def test_a_thing_anywhere_may_be_enclosed() -> None:
    finding = found()
    assert finding.code == "EC811"
    assert finding.severity == "error"
    assert len(finding.evidence["seeds"]) > 2
    assert "self.gems" in finding.message


@pytest.mark.parametrize("won", ["self.found >= 4", "self.found == 4 and self.at == (0, 0)", "len(self.gems) == 0"])
def test_the_code_may_count_the_things(won: str) -> None:
    assert found(won=won).code == "EC811"


@pytest.mark.parametrize(
    "changes",
    [
        {"placed": ON_THE_EDGE},
        # Enough without those that are enclosed.
        {"won": "self.found >= 2"},
        # As many losses as things.
        {"won": "self.at == (8, 11)", "more": "self.found += 1\n        if self.found >= 4: self.lost = True"},
        # A bonus, one of two ways to win, and as many as there are of something else.
        {"won": "self.at == (8, 11)", "more": "bonus = float(not self.gems)"},
        {"won": "not self.gems or self.at == (8, 11)"},
        # What opens the walls later.
        {"passes": "not self.walls[cell] or self.found > 2"},
        {"passes": "not (self.walls[cell] and self.t < 150)"},
        {"more": "if self.found == 3: self.dig(self.at)"},
        {"more": "if self.found == 3 and action[1]: self.at = (8, 11)"},
        {"more": "if self.found == 3: self.gems.pop()"},
        {"more": "for one in (self.at, self.kite):\n            if one in self.gems[3:]: self.gems.remove(one)"},
        {"more": "held = self.t > 150\n        held |= self.found > 2\n        if held: self.at = self.kite"},
        {"cell": "(self.at[0] + down) % 9, self.at[1] + right"},
        # On each seed: there may be a way that play does not find.
        {"placed": BEHIND_A_WALL},
        {"more": "self.walls[self.at] = False"},
        {"more": "if self.t == 150: self.walls[:] = False"},
        {"more": "if self.t % 20 == 0: self.gems.append((8, 11))"},
        {"more": "if action[1]: self.at = (0, int(self.np_random.integers(9)))"},
    ],
)
def test_nothing_is_said_where_there_may_be_a_way(changes: dict[str, Any]) -> None:
    assert found(**changes) is None


def test_two_attributes_may_be_the_cell() -> None:
    assert found(apart=True).code == "EC811"
