"""What lint says of generators, tables, surfaces and timers that outlive an episode, and of costs and bytes."""

from __future__ import annotations

from typing import Any

import pytest

from tests.checks.lint_games import found

GAME = """
import itertools
from enum import Enum
import numpy as np
import pygame
import gymnasium as gym
from gymnasium.utils import seeding
COUNT = itertools.count()
def ring(n, memo={{}}):
    if n not in memo:
        memo[n] = n * n
    return memo[n]
def dice(n, rng, memo={{}}):
    if n not in memo:
        memo[n] = rng.random()
    return memo[n]
class Herb(Enum):
    SAGE = 1
    THYME = 2
class Bug:
    serial = itertools.count()
    def __init__(self):
        self.number = next(Bug.serial)
    def swing(self):
        return self.number % 2
FINE, FARE_COST, MELT, NAMES = 2, -0.5, 10, ("barn", "mill")
class Wind:
    def __init__(self, rng):
        self.rng = rng
    def blow(self):
        return self.rng.random()
    def renew(self, rng):
        self.force = rng.random()
class Game(gym.Env):
    def __init__(self, render_mode=None):
        self.level = 0
        {init}
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.level, self.x, self.steps = 0, int(self.np_random.integers(9)), 0
        self.heat = np.zeros((6, 6))
        {reset}
        return self.see(), {{}}
    def step(self, action):
        reward = 0.0
        self.steps += 1
        if self.x == 3:
            self.level += 1
        {step}
        return self.see(), reward, {ended}, self.steps >= 500, {info}
    def see(self):
        return np.full((84, 84, 3), self.x % 9 + self.level, np.uint8)
    {more}
"""


def codes(**parts: Any) -> set[str]:
    empty = {"init": "pass", "reset": "pass", "step": "pass", "ended": "False", "info": "{}", "more": ""}
    filled = {**empty, **parts}
    return found(
        GAME.format(
            **{name: text if name == "more" else text.replace("\n", "\n        ") for name, text in filled.items()}
        )
    )


TABLE = "self.x += self.tables({0})"
DRAWN = """def tables(self, n):
        if n not in self.seen:
            self.seen[n] = self.np_random.integers(9)
        return self.seen[n]"""
GEMS = "self.gems = {{self.np_random.{} for _ in range(FINE)}}"
TAKEN = "self.gems.discard(self.x)"
HOT = "self.x += int((self.heat >= MELT).any())\nself.x += (self.heat.astype(np.uint8) * {} + 16)[0, 0]"
TIMER = "if self.x == 5:\n    self.frozen = 40\nif self.frozen > 0:\n    self.frozen -= 1\nelse:\n    self.x += 1"


@pytest.mark.parametrize(
    ("code", "parts"),
    [
        ("EC050", {"init": "self.wind = Wind(self.np_random)", "step": "self.x += self.wind.blow() > 0.5"}),
        ("EC050", {"init": "self.rng = self.np_random", "step": "self.x += self.rng.integers(2)"}),
        ("EC050", {"step": "self.x = np.random.default_rng(self.np_random_seed).integers(9)"}),
        ("EC050", {"step": "self.x = np.random.default_rng([self.np_random_seed, self.level]).integers(9)"}),
        ("EC050", {"step": "if self.x == 7:\n    self._np_random, _ = seeding.np_random(40 + self.level)"}),
        ("EC050", {"step": "if self.x == 7:\n    self.np_random = np.random.default_rng(7)"}),
        ("EC052", {"step": "self.go(NAMES[self.level])", "more": "def go(self, name): self.x = hash((3, name)) % 9"}),
        ("EC053", {"init": "self.seen = {}", "step": TABLE.format("self.level"), "more": DRAWN}),
        (
            "EC053",
            {
                "init": "self.seen = {}",
                "reset": "if seed is not None:\n    self.seen.clear()",
                "step": TABLE.format("self.x"),
                "more": DRAWN,
            },
        ),
        (
            "EC053",
            {
                "init": "self.page = pygame.Surface((9, 9))",
                "step": "pygame.draw.line(self.page, 9, (self.x, 0), (1, 1))",
            },
        ),
        ("EC052", {"step": "self.x = list(set(Herb))[0].value"}),
        (
            "EC052",
            {"reset": "self.moth = {'genes': sorted(NAMES)}", "step": "self.x = list(set(self.moth['genes']))[0]"},
        ),
        ("EC052", {"step": "found = []\nfor name in set(NAMES):\n    found.append(name)\nself.x = found[0]"}),
        ("EC052", {"step": "names = list(NAMES)\nself.x = [*{names[self.level]}, 2][0]"}),
        ("EC053", {"init": "self.frozen = 0", "step": TIMER}),
        ("EC053", {"step": "self.x += dice(self.level, self.np_random) > 0.5"}),
        ("EC053", {"reset": "self.bug = Bug()", "step": "self.x += self.bug.swing()"}),
        ("EC053", {"reset": "self.turn = next(COUNT)", "step": "self.x += self.turn % 3"}),
        ("EC059", {"reset": GEMS.format("integers(9)"), "step": f"{TAKEN}\nself.x += self.level >= FINE"}),
        (
            "EC059",
            {
                "reset": "self.gems = set()\nfor _ in range(FINE):\n    self.gems.add(self.np_random.integers(9))",
                "step": f"{TAKEN}\nself.x += self.level == FINE",
            },
        ),
        (
            "EC053",
            {
                "init": "self.won = False",
                "step": "if self.x == 8:\n    self.won = True",
                "ended": "self.x == 8",
                "info": "{'is_success': self.won}",
            },
        ),
        (
            "EC054",
            {
                "init": "self.seen = []",
                "step": "self.seen.append(1)",
                "reset": "self.seen = []",
                "info": "{'seen': self.seen}",
            },
        ),
        ("EC068", {"step": "if self.x == 5:\n    reward -= FARE_COST"}),
        ("EC068", {"init": "self.FEE_PENALTY = 3", "step": "reward = 1.0 - 0.5 + self.FEE_PENALTY"}),
        (
            "EC069",
            {
                "init": "self.pos, self.bat = np.zeros(2, np.uint8), np.zeros((3, 2), np.uint8)",
                "step": "self.x += np.abs(self.bat - self.pos).max() < 2",
            },
        ),
        (
            "EC069",
            {"step": HOT.format(32)},
        ),
    ],
)
def test_what_an_episode_leaves_to_the_next(code: str, parts: dict[str, str]) -> None:
    assert codes(**parts) == {code}


@pytest.mark.parametrize(
    "parts",
    [
        {
            "init": "self.wind = Wind(self.np_random)",
            "reset": "self.wind = Wind(self.np_random)",
            "step": "self.x += self.wind.blow() > 0.5",
        },
        {
            "init": "self.wind = Wind(self.np_random)",
            "reset": "self.wind.rng = self.np_random",
            "step": "self.x += self.wind.blow() > 0.5",
        },
        {
            "init": "self.wind = Wind(self.np_random)",
            "reset": "self.wind.renew(self.np_random)",
            "step": "self.x += self.wind.blow() > 0.5",
        },
        {
            "init": "self.rng = self.np_random",
            "reset": "self.rng = self.np_random",
            "step": "self.x += self.rng.random()",
        },
        {
            "reset": "self.key = int(self.np_random.integers(99))",
            "step": "self.x = np.random.default_rng(self.key).random()",
        },
        {
            "reset": "self.key = int(self.np_random.integers(99))",
            "step": "self.x = np.random.default_rng([self.np_random_seed, self.key]).random()",
        },
        {"reset": "if seed is not None:\n    self.x = np.random.default_rng(self.np_random_seed).integers(9)"},
        {"step": "if self.x == 7:\n    self.np_random = np.random.default_rng(self.np_random.integers(9))"},
        {"step": "self.go(self.level)", "more": "def go(self, name): self.x = hash((3, name)) % 9"},
        {"reset": "self.moth = {'genes': [1, 2]}", "step": "self.x = list(set(self.moth['genes']))[0]"},
        {
            "reset": "self.moth, self.word = {'genes': [1, 2]}, {'genes': list(NAMES)}",
            "step": "self.x = list(set(self.moth['genes']))[0]",
        },
        {"step": "card = tuple(('barn', 7))\nself.x = list({card[1], 8})[0]"},
        {"step": "found = []\nfor name in set(NAMES):\n    found.append(name)\nfound.sort()\nself.x = found[0]"},
        {"reset": "self.moth = {'genes': sorted(NAMES)}", "step": "self.x = sorted(set(self.moth['genes']))[0]"},
        {"reset": "self.moth = {'genes': sorted(NAMES)}", "step": "self.x = list(set(self.moth['ages']))[0]"},
        # A table that reset() empties, one by a drawn key, and one whose values belong to the key.
        {"init": "self.seen = {}", "reset": "self.seen.clear()", "step": TABLE.format("self.level"), "more": DRAWN},
        {"init": "self.seen = {}", "reset": "self.seen = {}", "step": TABLE.format("self.level"), "more": DRAWN},
        {"init": "self.seen = {}", "step": TABLE.format("self.x"), "more": DRAWN},
        {
            "init": "self.seen = {}",
            "step": TABLE.format("self.level"),
            "more": DRAWN.replace("self.np_random.integers(9)", "n * n"),
        },
        {
            "init": "self.page = pygame.Surface((9, 9))",
            "step": "self.page.fill(0)\npygame.draw.line(self.page, 9, (self.x, 0), (1, 1))",
        },
        {
            "init": "self.page = pygame.Surface((9, 9))",
            "step": "pygame.draw.rect(self.page, 0, (0, 0, 9, 9))\npygame.draw.line(self.page, 9, (self.x, 0), (1, 1))",
        },
        {"init": "self.page = pygame.Surface((9, 9))", "step": "pygame.draw.line(self.page, 9, (0, 0), (8, 8))"},
        # A timer that reset() stops, one of a state that sets it first, and one that always starts again.
        {"init": "self.frozen = 0", "reset": "self.frozen = 0", "step": TIMER},
        {"init": "self.frozen = 0", "reset": "self.calm()", "more": "def calm(self): self.frozen = 0", "step": TIMER},
        {
            "init": "self.frozen = 0",
            "step": TIMER.replace("if self.frozen > 0:", "if self.x == 6 and self.frozen > 0:"),
        },
        {"init": "self.frozen = 0", "step": f"self.frozen = 3\n{TIMER}"},
        {
            "init": "self.won = False",
            "reset": "self.won = False",
            "step": "if self.x == 8:\n    self.won = True",
            "ended": "self.x == 8",
            "info": "{'is_success': self.won}",
        },
        {"init": "self.won = False", "step": "if self.x == 8:\n    self.won = True", "info": "{'visited': self.won}"},
        {"reset": "self.seen = []", "step": "self.seen.append(1)", "info": "{'seen': list(self.seen)}"},
        {"reset": "self.seen = []", "step": "self.seen = [*self.seen, 1]", "info": "{'seen': self.seen}"},
        {"step": "self.x = sorted(set(Herb), key=lambda one: one.value)[0].value"},
        {"step": "self.x += ring(self.level)"},
        {"reset": "self.turn = next(COUNT)", "step": "self.turns = {self.turn: 1}"},
        # Each place has a number of its own, is put there again, or is not needed.
        {
            "reset": "self.gems = {(n, self.np_random.integers(9)) for n in range(FINE)}",
            "step": f"{TAKEN}\nself.x += self.level >= FINE",
        },
        {"reset": GEMS.format("integers(9)"), "step": f"{TAKEN}\nself.x += self.level >= FINE\nself.gems.add(3)"},
        {"reset": GEMS.format("integers(9)"), "step": f"{TAKEN}\nself.x += not self.gems"},
        {"reset": GEMS.format("integers(9)"), "step": "self.x += self.level >= FINE"},
        {
            "reset": GEMS.format("integers(9)")
            + "\nwhile len(self.gems) < FINE: self.gems.add(self.np_random.integers(9))",
            "step": f"{TAKEN}\nself.x += self.level >= FINE",
        },
        {"step": "reward -= FINE"},
        {"step": "reward += FARE_COST"},
        # A deposit that is paid back.
        {"step": "if self.x == 1:\n    reward -= FINE\nif self.x == 2:\n    reward += FINE"},
        {"step": "self.x += FINE"},
        {
            "init": "self.pos, self.bat = np.zeros(2, np.uint8), np.zeros((3, 2), int)",
            "step": "self.x += np.abs(self.bat - self.pos).max() < 2",
        },
        {
            "init": "self.pos, self.bat = np.zeros(2, np.uint8), np.zeros((3, 2), np.uint8)",
            "step": "self.x += np.abs(self.bat.astype(int) - self.pos).max() < 2",
        },
        {"step": HOT.format(25)},
    ],
)
def test_what_each_episode_makes_anew(parts: dict[str, str]) -> None:
    assert codes(**parts) <= {"EC057"}
