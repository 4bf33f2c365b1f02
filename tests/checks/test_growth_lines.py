"""Where memory grows, the line is named that alone makes a container larger which no episode empties."""

from __future__ import annotations

import pytest
from envcraft_checks.linting.growth import growing_line
from envcraft_checks.linting.program import Program

from envcraft.model.target import parse

GAME = """
from collections import deque

import gymnasium as gym

LOG = []


class Game(gym.Env):
    def __init__(self):
        self.log, self.seen, self.last = [], {}, deque(maxlen=9)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.now = []
        return 0, {}

    def step(self, action):
        self.now.append(action)
        self._note(action)
        return 0, 0.0, False, False, {}

    def _note(self, action):
        grow
"""


@pytest.mark.parametrize(
    ("statement", "named"),
    [
        ("self.log.append(action)", True),
        ("self.log += [action]", True),
        ("LOG.append(action)", True),
        ("self.seen[action, len(self.log)] = action", True),
        ("self.now.append(1)", False),
        ("self.last.append(action)", False),
        ("self.log.append(action); self.log.pop(0)", False),
        ("self.log.append(action); self.log = self.log[-9:]", False),
        ("self.log.append(action)\n        LOG.append(action)", False),
        ("log = []; log.append(action)", False),
    ],
)
def test_the_only_line_that_lets_memory_grow_is_named(statement: str, named: bool) -> None:
    text = GAME.replace("grow\n", f"{statement}\n")
    found = growing_line(Program(parse(text), "Game"), "step")
    assert found == (text.splitlines().index(f"        {statement}") + 1 if named else None)
    assert growing_line(Program(parse(text), "Game"), "reset") is None
