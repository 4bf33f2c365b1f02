"""Which containers reset() renews in the eyes of the check lint, although it does not bind them anew."""

from __future__ import annotations

from string import Template

import pytest
from envcraft_checks.linting.leftovers import leftovers
from envcraft_checks.linting.program import Program

from envcraft.model.target import parse

GAME = Template("""
import itertools
import gymnasium as gym
import numpy as np
from helpers import Base, clear_all

def empty(things):
    for thing in things:
        thing.clear()

def restart(game):
    game.x = []

def show(things):
    for thing in things:
        print(thing)

def first(things):
    return things[0]

class Unit:
    def reset(self): self.log = []

class Game($base):
    def __init__(self):
        self.x = $made
        self.other = []
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        $reset
        return self.see(), {}
    def step(self, action):
        $step
        return self.see(), 0.0, len(self.x) > 50, False, {}
    def see(self):
        $see
    def spill(self, things):
        while things:
            things.pop()
    def rows(self):
        return self.x
    def begin(self):
        self.x.clear()
""")
LISTS = {"made": "[[] for _ in range(3)]", "step": "self.x[action].append(1)"}
LIST = {"made": "[]", "step": "self.x.append(1)"}
SET = {"made": "set()", "step": "self.x.add(1)"}
COUNTS = {"made": "np.zeros(3)", "step": "self.x[action] += 1"}
UNITS = {"made": "[Unit()]", "step": "self.x.append(Unit())"}


def reported(**parts: str) -> bool:
    """Whether lint reports that an attribute outlives the episode in a game of these statements."""
    usual = {"base": "gym.Env", "reset": "pass", "see": "return np.array([len(one) for one in self.x])"}
    program = Program(parse(GAME.substitute(usual | parts).encode()))
    return bool(list(leftovers(program)))


@pytest.mark.parametrize("parts", [LISTS, LIST, SET, COUNTS, UNITS])
def test_a_container_that_reset_leaves_alone_outlives_the_episode(parts: dict[str, str]) -> None:
    assert reported(**parts)


@pytest.mark.parametrize(
    ("parts", "reset"),
    [
        (LISTS, "for one in self.x: one.clear()"),
        (LISTS, "for number, one in enumerate(self.x): one.clear()"),
        (LISTS, "for one, _ in zip(self.x, range(3)): one.clear()"),
        (LISTS, "for one in itertools.chain(self.x): one[:] = []"),
        (LISTS, "[one.clear() for one in self.x]"),
        (LISTS, "list(map(list.clear, self.x))"),
        (LISTS, "for one in self.x: one *= 0"),
        (LISTS, "for one in self.rows(): one.clear()"),
        (LISTS, "first(self.x).clear()"),
        (LISTS, "empty(self.x)"),
        (LISTS, "self.spill(self.x)"),
        (LISTS, "clear_all(self.x)"),
        (LISTS, "self.x.sort(); clear_all(things=self.x)"),
        (LIST, "things = self.x; things.clear()"),
        (LIST, "one, two = self.x, self.other; one.clear(); two.clear()"),
        (LIST, "(things := self.x).clear()"),
        (LIST, "things = self.x or []; del things[:]"),
        (LIST, "for things in (self.x, self.other): things.clear()"),
        (LIST, "for name in ('x', 'other'): getattr(self, name).clear()"),
        (LIST, "while self.x: self.x.pop()"),
        (LIST, "restart(self)"),
        (LIST, "del self.x"),
        (SET, "self.x -= self.x"),
        (SET, "self.x &= set()"),
        (COUNTS, "np.copyto(self.x, 0)"),
        (COUNTS, "np.multiply(self.x, 0, self.x)"),
        (COUNTS, "zeros = np.multiply(self.x, 0, out=self.x)"),
        (COUNTS, "self.x *= 0"),
        (COUNTS, "self.x &= False"),
        (COUNTS, "flat = self.x.ravel(); flat[:] = 0"),
        (UNITS, "for unit in self.x: unit.reset()"),
        (UNITS, "for unit in self.x: unit.log = []"),
    ],
)
def test_a_container_that_reset_may_change_is_renewed(parts: dict[str, str], reset: str) -> None:
    assert not reported(**parts, reset=reset)


@pytest.mark.parametrize(
    ("parts", "reset"),
    [
        (LIST, "count = len(self.x)"),
        (LIST, "total = sum(self.x); total *= 0"),
        (LIST, "show(self.x)"),
        (LIST, "print(self.x)"),
        (LIST, "empty(self.other)"),
        (LIST, "self.np_random.shuffle(self.x)"),
        (LIST, "self.goal = self.np_random.choice(self.x)"),
        (LIST, "self.goal = np.array(self.x)"),
        (LIST, "self.x += [1]"),
        (LIST, "for one in self.x: self.seen = one"),
        (LISTS, "for one in self.x: one.append(2)"),
        (SET, "self.x |= {1}"),
        ({"made": "1", "step": "self.x += 1"}, "self.unit = Unit(self.x)"),
        ({"made": "1", "step": "self.x += 1"}, "self.x -= 1"),
    ],
)
def test_a_container_that_reset_only_reads_or_fills_outlives_the_episode(parts: dict[str, str], reset: str) -> None:
    assert reported(**parts, reset=reset)


@pytest.mark.parametrize(
    "see",
    [
        "page = np.zeros(9)\n        for one in self.x: page[one] = 1\n        return page",
        "page = np.full(9, len(self.x)); page[:2] = 1; return page",
        "for one in self.x: one[0] += 1\n        return np.array(self.x)",
        "draw_all(self.x); return np.array(self.x)",
    ],
)
def test_what_draws_a_container_does_not_renew_it(see: str) -> None:
    assert reported(**LIST, see=see)


def test_the_base_of_another_file_may_call_what_renews() -> None:
    assert not reported(**LIST, base="Base")
    assert reported(**LISTS | {"made": "[]", "step": "self.other.append(1)"}, base="Base", see="return self.other")


def test_a_flag_that_reset_takes_back_by_calculation_is_renewed() -> None:
    flag = {"made": "False", "step": "\n        if action == 3: self.x = True", "see": "return np.array([self.x])"}
    assert reported(**flag)
    assert not reported(**flag, reset="self.x &= False")
