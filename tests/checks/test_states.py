"""The field that differs first between two runs, and the line that writes it, in games whose cause is known."""

from __future__ import annotations

import ast
import dataclasses
import textwrap
from pathlib import Path
from typing import Any

import pytest
from envcraft_checks.comparing.causes import Cause
from envcraft_checks.comparing.states import FieldDifference, first_field, in_words
from envcraft_checks.comparing.writers import Writers
from envcraft_checks.linting.once import uninitialised
from envcraft_checks.linting.program import Program

import envcraft
from envcraft.judging.budget import BUDGETS
from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout
from envcraft.model.target import Kind, Target
from envcraft.model.trace import Divergence, StateChange, Trace
from envcraft.model.verdict import Finding

_GAME = """
import functools
import random
import time
import gymnasium as gym
import numpy as np
from gymnasium import spaces
{top}

class Lane(gym.Env):
    metadata = {{"render_modes": ["rgb_array"], "render_fps": 30}}
    observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
    action_space = spaces.MultiDiscrete([5, 2, 2])
{owned}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
{made}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.lane, self.gate = 0, 5, int(self.np_random.integers(4, 80))
{reset}
        return self._frame(), {{"is_success": False}}

    def step(self, action):
        self.time += 1
        self.lane = int(np.clip(self.lane + (0, 0, 0, -3, 3)[int(action[0])], 2, 80))
{step}
        won = abs(self.lane - self.gate) < 3
        return self._frame(), float(won), won, self.time >= 200 and not won, {{"is_success": won}}

    def _frame(self):
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[:, self.gate] = 90
        frame[70:80, self.lane] = 255
        frame[0, self.time % 84] = 60
{shown}
        return frame
"""
#: A part of the picture that shows a small number.
_BAR = "frame[20:24, : 4 + int({}) % 80] = (200, 40, 0)"


def _game(top: str = "", owned: str = "", made: str = "", reset: str = "", step: str = "", shown: str = "") -> str:
    bodies = {"made": made, "reset": reset, "step": step, "shown": shown}
    inside = {name: textwrap.indent(textwrap.dedent(lines), " " * 8) for name, lines in bodies.items()}
    return _GAME.format(top=textwrap.dedent(top), owned=textwrap.indent(textwrap.dedent(owned), " " * 4), **inside)


def _found(source: str, workers: int = 1, **more: Any) -> dict[str, Finding]:
    options: Any = {"sandbox": "process", "budget": "quick", "checks": "determinism", "workers": workers}
    report = envcraft.validate(source, **options, **more)
    return {finding.code: finding for check in report.reports[0].checks for finding in check.findings}


CAUSES = {
    "an attribute that reset() does not set": (
        "EC206",
        "self.combo",
        {"made": "self.combo = 0", "step": "self.combo += 1  # here", "shown": _BAR.format("self.combo")},
    ),
    "an array that is read before it is written": (
        "EC206",
        "self.wind",
        {
            "owned": "def seen(self):\n    return self.wind.astype(int)\n",
            "made": "self.wind = np.zeros(2)",
            "step": "self.wind = self.wind + 1  # here",
            "shown": _BAR.format("self.seen()[0]"),
        },
    ),
    "a constant that step() sets": (
        "EC206",
        "self.boost",
        {
            "made": "self.boost = 1",
            "step": "if self.lane > 3:\n    self.boost = 9  # here",
            "shown": _BAR.format("self.boost * 5"),
        },
    ),
    "an attribute of an object": (
        "EC206",
        "self.bag.coins",
        {
            "top": "class Bag:\n    def __init__(self):\n        self.coins = 0\n",
            "made": "self.bag = Bag()",
            "step": "self.bag.coins += 2  # here",
            "shown": _BAR.format("self.bag.coins"),
        },
    ),
    "of two, the one that is shown": (
        "EC206",
        "self.lit",
        {
            "owned": "visited = set()",
            "made": "self.lit = np.zeros(8)",
            "step": "self.visited.add(self.lane)\nassert len(self.visited) < 500\nself.lit[self.lane % 8] = 1  # here",
            "shown": _BAR.format("sum(self.lit) * 9"),
        },
    ),
    "a list of the class": (
        "EC206",
        "Lane.trail",
        {
            "owned": "trail = []",
            "step": "self.trail.append(self.lane)  # here",
            "shown": _BAR.format("sum(self.trail)"),
        },
    ),
    "a list of the class, and another instance": (
        "EC207",
        "Lane.trail",
        {
            "owned": "trail = []",
            "reset": "self.trail.clear()",
            "step": "self.trail.append(self.lane)  # here",
            "shown": _BAR.format("sum(self.trail)"),
        },
    ),
    "a counter of the module": (
        "EC207",
        "EPISODES",
        {
            "top": "EPISODES = 0\n",
            "reset": "global EPISODES\nEPISODES += 1  # here",
            "shown": _BAR.format("EPISODES * 3"),
        },
    ),
    "a list of the module that another module's function changes": (
        "EC206",
        "NEST",
        {
            "top": "import heapq\nNEST = []\n",
            "step": "heapq.heappush(NEST, self.lane)  # here",
            "shown": _BAR.format("len(NEST)"),
        },
    ),
    "a list of the module that a function of the file takes": (
        "EC206",
        "NEST",
        {
            "top": "NEST = [0, 0]\ndef lay(nest, egg):\n    nest[egg % 2] += 1  # here\n",
            "step": "lay(NEST, self.lane)",
            "shown": _BAR.format("NEST[0]"),
        },
    ),
    "a dictionary of the module under another name": (
        "EC207",
        "PACE['owl']",
        {
            "top": "PACE = {'owl': 1}\n",
            "made": "self.pace = PACE",
            "reset": "self.pace['owl'] = 1",
            "step": "self.pace['owl'] += 1  # here",
            "shown": _BAR.format("self.pace['owl']"),
        },
    ),
    "a default argument": (
        "EC207",
        "Lane._put(where)",
        {
            "owned": "def _put(self, where=[]):\n    where.append(self.lane)  # here\n    return len(where)",
            "step": "self.depth = self._put()",
            "reset": "self.depth = 0",
            "shown": _BAR.format("self.depth"),
        },
    ),
    "a cached list that is emptied": (
        "EC206",
        "self.plan",
        {
            "top": "@functools.lru_cache\ndef plan(seed):\n    return [7, 30, 50, 9, 66, 20, 41]\n",
            "reset": "self.plan = plan(0)  # here\nself.rock = self.plan.pop()",
            "shown": _BAR.format("self.rock"),
        },
    ),
    "a generator of the module": (
        "EC207",
        "RNG",
        {
            "top": "RNG = np.random.default_rng(3)\n",
            "reset": "self.rock = int(RNG.integers(60))  # here",
            "shown": _BAR.format("self.rock"),
        },
    ),
    "a generator that the constructor makes": (
        "EC206",
        "self.dice",
        {
            "made": "self.dice = random.Random(3)  # here",
            "reset": "self.rock = self.dice.randrange(60)",
            "shown": _BAR.format("self.rock"),
        },
    ),
    "a value that reset() draws only once": (
        "EC206",
        "self.rock",
        {
            "made": "self.rock = None",
            "reset": "if self.rock is None:\n    self.rock = int(self.np_random.integers(60))  # here",
            "shown": _BAR.format("self.rock"),
        },
    ),
    "a value that a method draws only once": (
        "EC206",
        "self.rock",
        {
            "owned": "def _drawn(self):\n    return int(self.np_random.integers(60))\n",
            "reset": "if not hasattr(self, 'rock'):\n    self.rock = self._drawn()  # here",
            "shown": _BAR.format("self.rock"),
        },
    ),
    "a count that starts only once": (
        "EC206",
        "self.caught",
        {
            "reset": "if not hasattr(self, 'caught'):\n    self.caught = 0  # here",
            "step": "self.caught += 1",
            "shown": _BAR.format("self.caught"),
        },
    ),
    "a value that reset() makes of the old one": (
        "EC206",
        "self.lives",
        {
            "made": "self.lives = 30",
            "reset": "self.lives = self.lives if self.lives > 0 else 30  # here",
            "step": "self.lives -= 1",
            "shown": _BAR.format("self.lives"),
        },
    ),
    "walls that are not cleared": (
        "EC206",
        "self.walls",
        {
            "made": "self.walls = set()",
            "reset": "while len(self.walls) < 3 + self.gate % 2:\n"
            "    self.walls.add(int(self.np_random.integers(60)))  # here",
            "shown": _BAR.format("sum(self.walls)"),
        },
    ),
    "the global generator": (
        "EC204",
        "self.wind",
        {
            "reset": "self.wind = 0",
            "step": "self.wind = random.randrange(60)  # here",
            "shown": _BAR.format("self.wind"),
        },
    ),
    "the global generator, which reset() seeds": (
        "EC204",
        "self.wind",
        {
            "reset": "random.seed(seed)\nself.wind = random.randrange(60)",
            "step": "self.wind = self.wind % 60\nif random.random() < 0.5:  # here\n    self.wind += 7",
            "shown": _BAR.format("self.wind"),
        },
    ),
    "NumPy's global generator": (
        "EC204",
        "self.wind",
        {"reset": "self.wind = np.random.randint(60)  # here", "shown": _BAR.format("self.wind")},
    ),
    "the order of strings, in a list": (
        "EC203",
        "self.order",
        {
            "top": "KINDS = {'apple', 'pear', 'plum', 'fig', 'lime', 'date', 'kiwi'}\n",
            "reset": "self.order = [kind for kind in KINDS]  # here",
            "shown": _BAR.format("sum(map(ord, self.order[0])) * 3"),
        },
    ),
    "the order of strings, in the picture only": (
        "EC203",
        "iter(self.kinds)",
        {
            "made": "self.kinds = {'apple', 'pear', 'plum', 'fig', 'lime', 'date', 'kiwi'}",
            "shown": "first = next(iter(self.kinds))  # here\n" + _BAR.format("sum(map(ord, first)) * 3"),
        },
    ),
    "the action, which the caller may overwrite": (
        "EC215",
        "self.presses",
        {
            "reset": "self.presses, self.last = 0, np.zeros(3, int)",
            "step": "self.presses += int(action[1] and not self.last[1])\n"
            "self.last = np.asarray(action)  # here\n"
            "action = None",
            "shown": _BAR.format("self.presses * 5"),
        },
    ),
    "an action in a list": (
        "EC215",
        "self.lane",
        {
            "reset": "self.orders = [np.zeros(3, int)]",
            "step": "self.orders.append(action)  # here\nself.lane = (self.lane + int(self.orders.pop(0)[1])) % 80",
        },
    ),
    "the clock": (
        "EC205",
        "self.lamp",
        {"reset": "self.lamp = int(time.time() * 1000) % 60  # here", "shown": _BAR.format("self.lamp")},
    ),
    "the time since a step": (
        "EC205",
        "self.last",
        {
            "reset": "self.fuel, self.last = 50.0, time.time()  # here",
            "step": "now = time.time()\nself.fuel -= 40 * (now - self.last)\nself.last = now",
            "shown": _BAR.format("self.fuel * 20"),
        },
    ),
    "render()": (
        "EC208",
        "self.drawn",
        {
            "owned": "def render(self):\n    self.drawn += 1  # here\n    return self._frame()",
            "reset": "self.drawn = 0",
            "shown": _BAR.format("self.drawn * 5"),
        },
    ),
    "a method that render() calls, and not the line of step()": (
        "EC208",
        "self.lane",
        {
            "owned": """
                def render(self):
                    self._sway()
                    return self._frame()

                def _sway(self):
                    self.lane = min(self.lane + 1, 80)  # here
            """,
        },
    ),
}


_OWLS = "for owl in self.owls:\n    frame[20:24, int(np.sum(owl)) % 80] = (200, 40, 0)"
#: A game, and its line that creates once what play changes, or that changes it.
ONCE = {
    "a list of the module under another name": (
        "EC206",
        {
            "top": "START = [3, 9]\n",
            "reset": "self.owls = START",
            "step": "self.owls[0] += 1  # here",
            "shown": _OWLS,
        },
    ),
    "a list in a list of the module": (
        "EC206",
        {
            "top": "START = [[3, 1], [9, 2]]\n",
            "reset": "self.owls = list(START)",
            "step": "self.owls[0][0] += 1  # here",
            "shown": _OWLS,
        },
    ),
    "an array of the constructor under another name": (
        "EC206",
        {
            "made": "self.nest = np.array([3, 9])",
            "reset": "self.owls = self.nest  # here",
            "step": "self.owls[0] += 1",
            "shown": _OWLS,
        },
    ),
    "an array of the module under another name": (
        "EC206",
        {
            "top": "NEST = np.array([3, 9])\n",
            "reset": "self.owls = NEST  # here",
            "step": "self.owls[0] += 1",
            "shown": _OWLS,
        },
    ),
    "a list of the module that loses an item": (
        "EC206",
        {
            "top": "NEST = [3, 9, 27, 41] * 50\n",
            "reset": "self.owls = NEST  # here",
            "step": "if self.lane % 2:\n    self.owls.pop()",
            "shown": "frame[20:24, len(self.owls) % 80] = (200, 40, 0)",
        },
    ),
    "a variable of a function around another": (
        "EC207",
        {
            "top": "def counter():\n    count = 0\n    def tick():\n        nonlocal count\n"
            "        count += 1  # here\n        return count\n    return tick\n\ntick = counter()\n",
            "reset": "self.owls = [3]",
            "step": "if tick() % 2:\n    self.owls[0] += 1",
            "shown": _OWLS,
        },
    ),
    "a generator that reset() does not create again": (
        "EC206",
        {
            "owned": "def _gusts(self):\n    while True:\n        yield from (0, 0, 0, 1, 1)\n",
            "made": "self.gusts = self._gusts()  # here",
            "reset": "self.owls = [3]",
            "step": "if next(self.gusts):\n    self.owls[0] += 1",
            "shown": _OWLS,
        },
    ),
}


@pytest.mark.parametrize("name", ONCE)
def test_what_is_created_once_is_named(name: str) -> None:
    code, parts = ONCE[name]
    source = _game(**parts)
    finding = _found(source)[code]
    line = 1 + next(number for number, text in enumerate(source.splitlines()) if text.endswith("# here"))
    assert finding.line == line, finding.message
    assert "writes it" not in finding.message


def test_a_line_that_did_not_run_is_not_named_where_another_file_may_write(tmp_path: Path) -> None:
    (tmp_path / "lanes.py").write_text(
        "POOL = []\n\n\nclass Placed:\n    def place(self):\n        POOL.append(1)\n"
        "        self.rock = len(POOL) % 9\n"
    )
    source = _game(
        "from lanes import Placed", reset="self.place()", step="self.rock += 0", shown=_BAR.format("self.rock")
    )
    game = tmp_path / "game.py"
    game.write_text(source.replace("class Lane(", "class Lane(Placed, "))
    finding = _found(str(game), contract="gymnasium")["EC206"]
    assert "writes it" not in finding.message
    assert "def reset" in game.read_text().splitlines()[(finding.line or 0) - 1]


def test_a_cache_of_another_file_is_named_there_and_once(tmp_path: Path) -> None:
    (tmp_path / "levels.py").write_text(
        "CACHE = {}\n\n\ndef level(n):\n    CACHE[n] = CACHE.get(n, 0) + 1\n    return CACHE[n] % 9\n"
    )
    game = tmp_path / "game.py"
    game.write_text(_game("import levels", reset="self.rock = levels.level(1)", shown=_BAR.format("self.rock")))
    [finding] = _found(str(game), contract="gymnasium").values()
    assert finding.code == "EC207"
    assert finding.message.endswith("levels.py line 5 changes CACHE, which all episodes and instances share")
    assert [line.rpartition("levels.py")[2] for line in finding.evidence["lines"]] == [":5"]


def test_a_generator_with_a_fixed_seed_is_named() -> None:
    parts = {"made": "self.rng = np.random.default_rng(0)  # here", "reset": "self.lane = int(self.rng.integers(80))"}
    source = _game(**parts)
    finding = _found(source)["EC206"]
    assert source.splitlines()[(finding.line or 0) - 1].endswith("# here")
    assert "creates self.rng with a fixed seed, and reset() does not seed it again" in finding.message


def test_a_constant_seed_is_named() -> None:
    source = _game().replace("super().reset(seed=seed)", "super().reset(seed=42)  # here")
    finding = _found(source)["EC209"]
    assert "seeds with a constant: super().reset(seed=42)" in finding.message
    assert source.splitlines()[(finding.line or 0) - 1].endswith("# here")


def test_uninitialised_memory_is_named() -> None:
    source = _game(shown="frame = np.empty((84, 84, 3), np.uint8)  # here\nframe[:70] = 0")
    # What the memory holds is up to the system, so play need not show it.
    [found] = uninitialised(Program(ast.parse(source)))
    assert source.splitlines()[found.line - 1].endswith("# here")
    assert "uninitialised memory" in found.words


@pytest.mark.parametrize("name", CAUSES)
def test_the_cause_is_named(name: str) -> None:
    code, path, parts = CAUSES[name]
    source = _game(**parts)
    finding = _found(source)[code]
    state = finding.evidence["state"]
    line = 1 + next(number for number, text in enumerate(source.splitlines()) if text.endswith("# here"))
    assert (state["path"], finding.line) == (path, line), finding.message
    words = f"the order of {path[5:-1]}" if path.startswith("iter(") else path
    assert f"; {words} differs first, after " in finding.message


def test_a_list_in_the_order_of_a_set_of_objects(root: Path) -> None:
    finding = _found(str(root / "tests/fixtures/determinism/bad/set_of_objects.py"))["EC202"]
    # Which of the three lists differs first depends on where the interpreter's memory lies.
    assert (finding.evidence["state"]["path"], finding.line) in [("LEFT", 21), ("RIGHT", 22), ("LOW", 23)]


def test_a_seed_that_is_not_passed_on_is_named() -> None:
    source = _game().replace("super().reset(seed=seed)", "super().reset()  # here")
    finding = _found(source)["EC201"]
    line = 1 + next(number for number, text in enumerate(source.splitlines()) if text.endswith("# here"))
    assert finding.line == line, finding.message
    assert f"line {line} does not pass the seed on" in finding.message


def test_a_clock_that_leaves_no_field_is_named() -> None:
    shown = "bob = pygame.time.get_ticks() % 40  # here\nframe[bob : bob + 4, :3] = 200"
    source = _game(top="import pygame\n", made="pygame.init()", shown=shown)
    finding = _found(source)["EC205"]
    line = 1 + next(number for number, text in enumerate(source.splitlines()) if text.endswith("# here"))
    assert finding.line == line
    assert f"line {line} reads the clock, pygame.time.get_ticks()" in finding.message


def test_values_are_shown() -> None:
    parts: Any = {"made": "self.speed = 0.25", "step": "self.speed += 0.5", "shown": _BAR.format("self.speed * 8")}
    finding = _found(_game(**parts))["EC206"]
    assert "; self.speed differs first, after the reset: 0.25 and " in finding.message
    assert (finding.evidence["state"]["step"], finding.evidence["state"]["first"]) == (0, "0.25")


BESIDE: dict[str, tuple[str, dict[str, str]]] = {
    "a cache that is filled": (
        "EC206",
        {
            "made": "self.table = {}",
            "reset": "if self.gate not in self.table:\n    self.table[self.gate] = self.gate * 2",
        },
    ),
    "a picture that is made once": (
        "EC206",
        {"made": "self.picture = None", "reset": "if self.picture is None:\n    self.picture = np.zeros((4, 4))"},
    ),
    "a count that nothing reads": ("EC206", {"made": "self.episodes = 0", "reset": "self.episodes += 1"}),
    "the time of the start": ("EC206", {"reset": "self.started = time.time()"}),
    "the time of the start under another clock": ("EC204", {"reset": "self.started = time.time()"}),
    "an identity": ("EC206", {"reset": "self.token = id(object())"}),
}


@pytest.mark.parametrize("name", BESIDE)
def test_what_differs_and_does_not_matter_is_not_named(name: str) -> None:
    code, beside = BESIDE[name]
    drawn = code == "EC204"
    parts = {
        "made": beside.get("made", "") + "\nself.combo = 0",
        # What does not matter differs first, and is read first.
        "reset": beside["reset"] + ("\nself.combo = 0" if drawn else ""),
        "step": "self.combo = random.randrange(60)" if drawn else "self.combo += 1",
        "shown": _BAR.format("self.combo"),
    }
    assert _found(_game(**parts))[code].evidence["state"]["path"] == "self.combo"


def test_the_report_does_not_depend_on_the_number_of_workers() -> None:
    _, _, parts = CAUSES["walls that are not cleared"]
    one, two = (_found(_game(**parts), workers) for workers in (1, 3))
    assert one == two
    assert "state" in one["EC206"].evidence


_TRAPS = """
class Trap:
    def __init__(self):
        self.inside = 0

    def __getattribute__(self, name):
        raise RuntimeError("read")

    def __repr__(self):
        raise SystemExit("shown")

    __str__ = __len__ = __iter__ = __bool__ = __index__ = __repr__

    def __eq__(self, other):
        raise KeyboardInterrupt("compared")

    def __hash__(self):
        return 7


class Hidden:
    @property
    def __dict__(self):
        raise SystemExit("listed")


class Names(dict):
    def items(self):
        raise SystemExit("items")

    __iter__ = keys = values = items


def endless():
    made = []
    for _ in range(3000):
        made = [made, made]
    return made
"""


def test_traps_are_not_entered() -> None:
    parts = {
        "top": _TRAPS,
        "made": "self.trap, self.hidden, self.names = Trap(), Hidden(), Names(a=1)\n"
        "self.ring = []\nself.ring.append(self.ring)\nself.deep = endless()\n"
        "self.big = list(range(100_000))\nself.many = [[number] for number in range(50_000)]\n"
        "self.own = {self.trap: self}\nself.combo = 0",
        "step": "self.combo += 1  # here",
        "shown": _BAR.format("self.combo"),
    }
    found = _found(_game(**parts))
    assert set(found) == {"EC206"}
    assert found["EC206"].evidence["state"]["path"] == "self.combo"


class Played:
    """A subject whose states are given: those of the first run, of the second, and of the first again."""

    target = Target("Walk-v0", kind=Kind.ID)
    installed_source = b""
    budget = BUDGETS["quick"]

    def __init__(self, *runs: list[dict[str, str]], steps: int = 100) -> None:
        self._runs = list(runs)
        self.left = steps

    def affords(self, steps: int) -> bool:
        return steps <= self.left

    def rerun(self, rollout: Rollout) -> Trace:
        assert rollout.fields
        states = self._runs.pop(0)
        changes: list[StateChange] = []
        known: dict[str, str] = {}
        for state in states:
            state = {path: text for path, text in state.items() if path != "seen"}
            changed = {path: (text, text) for path, text in state.items() if known.get(path) != text}
            changes.append(StateChange(changed, tuple(known.keys() - state.keys()), frozenset({len(changes)})))
            known = state
        flags: Any = [False] * (len(states) - 1)
        observations = [state.get("seen", "").encode() for state in states]
        return Trace(rollout, observations, [b""] * len(states), [0.0] * len(flags), [], flags, flags, states=changes)


def _named(*runs: list[dict[str, str]], under: Conditions | None = None, steps: int = 100) -> FieldDifference | None:
    subject: Any = Played(*runs, steps=steps)
    under = under or Conditions(before=[Episode(0, [0])])
    last = len(runs[0]) - 1
    cause = Cause("EC206", under, Divergence(last, "observation"))
    return first_field(subject, Rollout(0, [0] * last), cause, Writers(subject, "EC206"))


PLAIN = [{"self.a": "1", "seen": "1"}, {"self.a": "2", "seen": "2"}]


def test_the_earliest_field_is_named() -> None:
    first = [
        {"self.a": "1", "self.b": "1"},
        {"self.a": "2", "self.b": "1"},
        {"self.a": "2", "self.b": "1", "seen": "1"},
    ]
    second = [*first[:1], {"self.a": "3", "self.b": "1"}, {"self.a": "3", "self.b": "9", "seen": "2"}]
    assert _named(first, second, first) == ("self.a", 1, "2", "3", None, frozenset({1}))


def test_a_field_that_is_new_or_gone_differs() -> None:
    other = [{"seen": "1"}, {"self.a": "2", "seen": "3"}]
    named = _named(PLAIN, other, PLAIN)
    assert named is not None
    assert named[:4] == ("self.a", 0, "1", "(absent)")


def test_what_differs_between_equal_runs_is_not_named() -> None:
    noisy = [[{"self.at": f"{number}", **state} for state in PLAIN] for number in range(3)]
    other = [{"self.at": "7", "self.a": "5", "seen": "1"}, {"self.at": "7", "self.a": "6", "seen": "3"}]
    named = _named(noisy[0], other, noisy[1])
    assert named is not None
    assert (named.path, named.step) == ("self.a", 0)


def test_a_field_that_differs_in_a_later_equal_state_is_noise_throughout() -> None:
    again = [PLAIN[0], {"self.a": "4", "seen": "2"}]
    other = [{"self.a": "9", "seen": "1"}, {"self.a": "9", "seen": "3"}]
    assert _named(PLAIN, other, again) is None


def test_global_generators_are_not_named_where_a_condition_sets_them() -> None:
    under = Conditions(perturb=3, global_seed=3)
    one, two = ([{"random": text, "seen": text}] for text in "12")
    assert _named(one, two, one, one, two, one, under=under) is None
    named = _named(one, two, one)
    assert named is not None
    assert named.path == "random"


def test_the_order_of_a_set_counts_only_if_no_value_does() -> None:
    one, two = ([{"iter(self.s)": text}, {"iter(self.s)": text, "self.a": text, "seen": text}] for text in "12")
    named = _named(one, two, one)
    assert named is not None
    assert (named.path, named.step) == ("self.a", 1)
    one, two = ([{"iter(self.s)": text}, {"iter(self.s)": text, "seen": text}] for text in "12")
    named = _named(one, two, one)
    assert str(named) == "the order of self.s differs first, after the reset: 1 and 2"


def test_runs_that_do_not_differ_again_name_nothing() -> None:
    assert _named(PLAIN, PLAIN, PLAIN) is None


@pytest.mark.parametrize(("steps", "known"), [(3, False), (4, True)])
def test_nothing_is_named_beyond_the_budget(steps: int, known: bool) -> None:
    other = [PLAIN[0], {"self.a": "3", "seen": "3"}]
    assert (_named(PLAIN, other, PLAIN, steps=steps) is not None) is known


def test_repetitions_have_no_run_that_is_equal() -> None:
    class Twice(Played):
        def rerun(self, rollout: Rollout) -> Trace:
            first = super().rerun(rollout)
            return dataclasses.replace(super().rerun(rollout), earlier=first)

    subject: Any = Twice(PLAIN, [PLAIN[0], {"self.a": "3", "seen": "3"}])
    cause = Cause("EC201", Conditions(again=True), Divergence(1, "observation"))
    named = first_field(subject, Rollout(0, [0]), cause, Writers(subject, "EC201"))
    assert named is not None
    assert named.path == "self.a"


def test_a_logical_clock_is_tried_before_the_usual_one() -> None:
    class Timed(Played):
        clocks: list[ClockShift | None] = []

        def rerun(self, rollout: Rollout) -> Trace:
            self.clocks.append(rollout.conditions.clock)
            return super().rerun(rollout)

    other = [{"self.a": "5", "seen": "5"}]
    subject: Any = Timed(*[PLAIN[:1]] * 7, other, PLAIN[:1])
    shifted = ClockShift(5.0, 2.0)
    cause = Cause("EC205", Conditions(clock=shifted), Divergence(0, "observation"))
    named = first_field(subject, Rollout(0, []), cause, Writers(subject, "EC205"))
    logical = ClockShift(0.0, 0.0)
    assert named is not None
    assert named.path == "self.a"
    moved = ClockShift(5.0, 0.0)
    assert subject.clocks == [logical, moved, logical, logical, shifted, logical, None, shifted, None]


def test_words_without_a_field_are_those_of_the_file() -> None:
    subject: Any = Played()
    assert in_words(Writers(subject, "EC206"), None) == ("", None)
