"""Two games whose statements the tests of the check lint fill in, and the codes that it reports on them."""

from __future__ import annotations

import ast

from envcraft_checks.lint import Lint

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.selection import driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.target import Target
from envcraft.model.verdict import Severity

GAME = """
import functools, itertools, math, random, time
import numpy as np
import gymnasium as gym
LIMIT = 5
class Game(gym.Env):
    shared = []
    def __init__(self):
        self.count = 0
        self.canvas = np.zeros(4)
    def reset(self, *, seed=None, options=None):
        {super}
        {reset}
        return self.see(), {{}}
    def step(self, action):
        {step}
        return self.see(), 0.0, {ended}, False, {{}}
    def see(self):
        {see}
    {more}
"""

#: A game with three buttons, whose statements the tests fill in.
BUTTONS = """
import enum, logging
import numpy as np
import gymnasium as gym
LOG = logging.getLogger("game")
MOVES = {{0: (0, 0), 1: (0, 1), {moves}}}
class Key(enum.IntEnum):
    STAY = 0
    JUMP = 7
class Game(gym.Env):
    def __init__(self):
        self.observation_space = gym.spaces.Discrete(9)
        self.action_space = gym.spaces.{space}
        self.total = 0
        self.record = []
        self.grid = np.zeros((9, 9))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = self.y = self.streak = self.streak_left = 0
        self.hearts = np.uint8(5)
        self.lives = np.full(3, 4, dtype=np.uint8)
        self.lamps = [1, 2, 3]
        {reset}
        return self.see(), {{}}
    def step(self, action):
        reward = 0.0
        self.y += 1
        {step}
        return self.see(), reward, False, self.y > 99, {info}
    def see(self):
        return self.x % 9
    def _go(self, code, far=1):
        {go}
{more}
"""


def codes(**parts: str) -> set[str]:
    """The codes that lint reports, also those that are off by default, on a game with these statements."""
    filled = {
        "super": "super().reset(seed=seed)",
        "reset": "pass",
        "step": "pass",
        "ended": "False",
        "see": "return np.zeros(4)",
        "more": "",
        **parts,
    }
    return found(GAME.format(**filled))


def pressed(step: str, **parts: str) -> dict[str, bool]:
    """The codes that lint reports on a game with these statements, and whether each is an error."""
    filled = {
        "space": "MultiDiscrete([5, 2, 2])",
        "moves": "2: (1, 0)",
        "reset": "pass",
        "info": "{}",
        "go": "self.x += code",
        "more": "",
        **parts,
    }
    return judged(BUTTONS.format(step=step.replace("\n", "\n        "), **filled))


def found(source: str) -> set[str]:
    """The codes that lint reports on a source."""
    return set(judged(source))


def judged(source: str) -> dict[str, bool]:
    """The codes that lint reports on a source, and whether each is an error."""
    ast.parse(source)
    with subject_of(Target("game.py", source.encode())) as subject:
        return {finding.code: finding.severity is Severity.ERROR for finding in Lint().judge(subject)}


def subject_of(target: Target) -> Subject:
    """What lint receives to judge a target."""
    return Subject(target, ARCADE, WorkerPool(driver_named("process", probe=False)).lease(), BUDGETS["quick"])
