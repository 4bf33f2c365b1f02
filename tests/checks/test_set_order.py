"""The line of a finding about the order of a set, where the check lint cannot tell that the order matters."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from envcraft_checks.linting.order import addresses, orders, turns
from envcraft_checks.linting.program import Program

import envcraft

FIXTURES = Path(__file__).resolve().parents[1] / "fixtures"
GAME = """
import enum
import gymnasium as gym
import numpy as np

class Way(enum.Enum):
    UP = 1
    DOWN = 2

class Ball:
    pass

class Words(gym.Env):
    observation_space = gym.spaces.Box(0, 60, (2,), np.int64)
    action_space = gym.spaces.Discrete(3)

    def __init__(self):
        self.words = {"north", "south", "east", "west", "up", "northeast", "downstream"}
        self.balls = {Ball(), Ball()}
        self.seen = set()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.n, self.last = int(self.np_random.integers(4)), 0, 0
        return self._look(), {}

    def step(self, action):
        self.at = min(max(self.at + int(action) - 1, 0), 20)
        self.n += 1
        return self._look(), float(self.at), self.at > 9, self.n >= 20, {}

    def _look(self):
        last = 0
        {look}
        return np.array([self.at, last], np.int64)
"""
STRINGS = ("strings", "members of an enumeration")


def _game(look: str) -> str:
    return GAME.replace("{look}", look.replace("\n", "\n        "))


@pytest.mark.parametrize(
    ("look", "kinds", "words"),
    [
        ("for word in self.words:  # here\n    last = len(word)", STRINGS, "a set of strings: self.words"),
        ("words = self.words\nfor word in words:  # here\n    last = len(word)", STRINGS, "a set of strings: words"),
        ("for way in {Way.UP, Way.DOWN}:  # here\n    last = way.value", STRINGS, "a set of members of an enumeration"),
        ("last = len(max({'a', 'b'}, key=len))  # here", STRINGS, "a set of strings: {'a', 'b'}"),
        ("last = {0: len(word) for word in self.words}[0]  # here", STRINGS, "a set of strings: self.words"),
        ("for ball in self.balls:  # here\n    last = ball.x", ("objects",), "a set of objects: self.balls"),
        ("for one in self.seen:  # here\n    last = one", STRINGS, "a set: self.seen"),
        ("for one in self.seen | {1}:  # here\n    last = one", STRINGS, "a set: self.seen | {1}"),
    ],
)
def test_what_may_use_an_order(look: str, kinds: tuple[str, ...], words: str) -> None:
    source = _game(look)
    program = Program(ast.parse(source))
    [suspect] = turns(program, kinds)
    assert source.splitlines()[suspect.line - 1].endswith("# here")
    assert suspect.words.startswith(f"may use the order of {words}")
    assert not list(orders(program))


@pytest.mark.parametrize(
    "look",
    [
        "last = len({'a', 'b'})",
        "last = 'north' in self.words",
        "for one in {3, 4}:\n    last = one",
        "for ball in self.balls:\n    last = ball.x",
        "for word in sorted(self.words):\n    last = len(word)",
    ],
)
def test_what_uses_no_order_of_strings(look: str) -> None:
    assert not list(turns(Program(ast.parse(_game(look))), STRINGS))


@pytest.mark.parametrize(
    "look",
    [
        "for word in self.words:  # here\n    last = len(word)",
        "for word in self.words:  # here\n    self.last = len(word)\nlast = self.last",
    ],
)
def test_a_loop_whose_last_turn_counts_has_the_line_of_the_finding(look: str) -> None:
    source, options = _game(look), {"sandbox": "process", "budget": "quick", "contract": "gymnasium"}
    [report] = envcraft.validate(source, checks="determinism", **dict[str, Any](options)).reports
    [finding] = [one for check in report.checks for one in check.findings if one.code == "EC203"]
    line = next(number for number, text in enumerate(source.splitlines(), 1) if text.endswith("# here"))
    assert finding.line == line, finding.message
    assert f"line {line} may use the order of a set of strings: self.words" in finding.message


@pytest.mark.parametrize(
    ("look", "words"),
    [
        ("last = id(self.words) // 16 % 60", "calculates with an address in memory: id(self.words)"),
        ("last = sorted([self.seen, self.words], key=id).index(self.seen)", "sorts by id()"),
        ("last = hash('up') % 60", ""),
        ("last = len(sorted(self.words, key=hash))", ""),
    ],
)
def test_what_uses_an_address(look: str, words: str) -> None:
    found = list(addresses(Program(ast.parse(_game(look)), "Words")))
    assert [suspect.words for suspect in found] == [words] * bool(words)
    assert all(suspect in orders(Program(ast.parse(_game(look)), "Words")) for suspect in found)


def test_an_address_that_few_layouts_of_memory_change_is_named() -> None:
    text = (FIXTURES / "termination" / "good" / "short_rounds.py").read_text()
    drawn = "a, b = object(), object()\n        self.hammer = int(id(a) % 64 < 32)\n        self.kept = a, b\n"
    text = text.replace("self.hammer = 0\n", drawn)
    report = envcraft.validate(text, sandbox="process", checks="determinism").reports[0]
    [found] = [finding for check in report.checks for finding in check.findings]
    assert found.code == "EC202"
    assert "calculates with an address in memory: id(a)" in found.message
