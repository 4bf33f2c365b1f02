"""When a cached result depends on what play changes, and when it is dropped in time."""

from __future__ import annotations

import pytest

from tests.checks.lint_games import codes, found

TINT = "@functools.cached_property\n    def tint(self): return 3 * self.start"
START = "self.start = int(self.np_random.integers(9))"
SHOWN = "return np.full(4, self.tint)"
HELPER = """
import functools
import gymnasium as gym
class Start:
    def __init__(self, you): self.you = you
    @functools.cached_property
    def tint(self): return 3 * self.you
    def move(self): {move}
class Game(gym.Env):
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.you = int(self.np_random.integers(9))
        self.start = Start(self.you)
        return self.start.tint, {{}}
    def step(self, action):
        self.you += 1
        self.start.move()
        return self.start.tint, 0.0, self.you > 99, False, {{}}
"""


@pytest.mark.parametrize(
    "forget",
    [
        "self.__dict__.pop('tint', None)",
        "if 'tint' in self.__dict__: del self.tint",
        "if 'tint' in vars(self): del self.__dict__['tint']",
        "if hasattr(self, 'start'): delattr(self, 'tint')",
        "vars(self).clear()",
        "self.more()",
    ],
)
def test_a_result_that_reset_drops(forget: str) -> None:
    more = f"{TINT}\n    def more(self): self.__dict__.pop('tint', None)"
    assert codes(reset=f"{START}\n        {forget}", see=SHOWN, more=more) == set()


def test_a_cache_that_step_clears() -> None:
    more = "@functools.cache\n    def tint(self): return self.x"
    parts = {"reset": "self.x = 0; Game.tint.cache_clear()", "see": "return np.full(4, self.tint())", "more": more}
    assert codes(**parts, step="self.x += 1; Game.tint.cache_clear()") == set()
    assert codes(**parts, step="self.x += 1") == {"EC053"}


@pytest.mark.parametrize(
    "parts",
    [
        {"reset": START},
        {"reset": f"{START}; self.__dict__.pop('other', None)"},
        {"reset": f"{START}; self.__dict__.pop('tint', None)", "step": "self.start += 1"},
    ],
)
def test_a_result_that_outlives_what_it_depends_on(parts: dict[str, str]) -> None:
    assert codes(**parts, see=SHOWN, more=TINT) == {"EC053"}


def test_a_helper_has_attributes_of_its_own() -> None:
    assert found(HELPER.format(move="return self.you")) == set()
    assert found(HELPER.format(move="self.you += 1")) == {"EC053"}


@pytest.mark.parametrize(("kept", "expected"), [("order", set()), ("self.ways", {"EC053"})])
def test_a_table_of_the_class(kept: str, expected: set[str]) -> None:
    more = f"""ways = []
    charts = {{}}
    def chart(self, goal):
        if goal not in self.charts:
            order = [2]
            {kept}.append(goal)
            self.charts[goal] = {kept}[0] * goal
        return self.charts[goal]"""
    assert codes(reset=START, see="return np.full(4, self.chart(self.start))", more=more) == expected


def test_a_table_that_an_exception_fills() -> None:
    more = """charts = {}
    def chart(self, goal):
        try: return self.charts[goal]
        except KeyError:
            self.charts[goal] = goal * 2
            return self.charts[goal]"""
    assert codes(reset=START, see="return np.full(4, self.chart(self.start))", more=more) == set()
