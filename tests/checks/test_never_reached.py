"""Which lines EC809 names: those that play may come to, and that pay, win or end the episode."""

from __future__ import annotations

import textwrap

import pytest
from envcraft_checks.api import Api
from envcraft_checks.sandbox import SandboxEvents
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.coverage import Coverage
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from evaluation.fixtures import FIXTURES

GAME = """
import gymnasium as gym

class Game(gym.Env):
    LIMIT = 100

    def __init__(self, hard=False):
        self.hard = hard

    def reset(self, *, seed=None, options=None):
        self.score, self.lives, self.steps, self.done = 0, 3, 0, False
        return None, {{}}

    def step(self, action):
        reward, won = 0.0, False
{body}
        return None, reward, won, False, {{}}

    def _unused(self):
        self.score = 7
"""


def missed(body: str, reached: tuple[int, ...] = (), extra: str = "") -> list[str]:
    """What is named if only the first line of step() and these lines of the body were reached."""
    source = GAME.format(body=textwrap.indent(textwrap.dedent(body).strip("\n"), " " * 8)) + extra
    coverage = Coverage(Target("game.py", source.encode()))
    first = source.splitlines().index("        reward, won = 0.0, False") + 1
    lines = {first, *(first + number for number in reached)}
    coverage.add("".join("1" if line in lines else "0" for line, _ in coverage.places))
    return [str(each).replace(f"line {each.first},", f"line {each.first - first},") for each in coverage.missed()]


def test_only_what_was_not_reached_is_named() -> None:
    body = "if self.lives == 9:\n    reward = 1.0\nelse:\n    reward = 2.0"
    assert missed(body) == ["line 2, which pays", "line 4, which pays"]
    assert missed(body, (2,)) == ["line 4, which pays"]
    assert missed(body, (2, 4)) == []


@pytest.mark.parametrize(
    "body",
    [
        "if self.lives == 9:\n    reward = 1.0",
        "if self.lives == 9:\n    x = 1\n    won = True",
        "if self.lives == 9: self.score = 1",
        "if action[0]:\n    x = 1\n    if x > self.lives:\n        self.game_over = True",
        "if self.lives == 9:\n    return None, 1.0, True, False, {}",
        "if self.lives == 9:\n    info = {}\n    info['is_success'] = True",
        "while self.lives > 9:\n    reward, won = 1.0, True",
        "match action[0]:\n    case 9:\n        self.done = True",
        "for lost in self.found:\n    self.lost = lost",
        "if self.hard and self.lives > 9:\n    reward = 1.0",
    ],
)
def test_lines_that_matter_are_named(body: str) -> None:
    assert len(missed(body)) == 1


@pytest.mark.parametrize(
    "body",
    [
        "if self.hard:\n    reward = 1.0",
        "if self.LIMIT > 200:\n    reward = 1.0",
        "if self.steps >= self.LIMIT:\n    self.done = True",
        "if self.lives > 9:\n    reward = 0.0\n    self.done = False",
        "if self.lives > 9:\n    truncated = True",
        "if self.lives > 9:\n    reward = -1.0",
        "if self.lives > 9:\n    reward -= self.lives",
        "if self.lives > 9:\n    return None, -1.0, False, False, {}",
        "if self.lives > 9:\n    self.score_text = 'nine'",
        "if self.render_mode == 'human':\n    self.score = 1",
        "if not self.action_space.contains(action):\n    reward = 1.0",
        "if self.lives > 9:\n    self.done = True\n    raise ValueError(action)",
        "if self.done:\n    return None, 1.0, True, False, {}",
        "try:\n    x = action[0]\nexcept IndexError:\n    reward = 1.0",
        "if self.render_mode == 'human':\n    self._unused()",
        "def inner():\n    self.score = 1",
        "x = 1",
    ],
)
def test_lines_that_play_need_not_reach_are_not(body: str) -> None:
    assert missed(body) == []


def test_functions_that_step_calls_count() -> None:
    assert len(missed("if self.lives > 9:\n    self._unused()")) == 1
    assert len(missed("self._unused()")) == 1


def test_of_two_functions_of_one_name_those_count_that_run() -> None:
    other = "\n\nclass Other(Game):\n    def _unused(self):\n        x = 1\n        self.won = x\n"
    assert missed("self._unused()", extra=other) == []


def test_adjacent_lines_are_one_range() -> None:
    body = "if self.lives > 9:\n    reward = 1.0\n    x = 1\n    x = 2\n    won = True\n"
    body += "elif self.lives > 8:\n    won = True"
    assert [text.partition(",")[2] for text in missed(body)] == [" which win and pay", " which wins"]


@pytest.mark.parametrize("source", ["import numba\n", "import inspect\n", "def (\n", "\0"])
def test_code_that_looks_at_code_has_no_marks(source: str) -> None:
    assert Coverage(Target("game.py", (source + GAME.format(body="")).encode())).places == []


def test_nothing_is_said_without_play() -> None:
    source = GAME.format(body="        if self.lives == 9:\n            reward = 1.0")
    coverage = Coverage(Target("game.py", source.encode()))
    assert coverage.places
    assert coverage.missed() == []


def test_many_functions_take_little_time() -> None:
    many = "".join(f"def f{number}():\n    'nothing'\n" for number in range(20_000))
    coverage = Coverage(Target("game.py", (GAME.format(body="        self.x = [f0]") + many).encode()))
    coverage.add("1" * len(coverage.places))
    assert coverage.missed() == []


@pytest.mark.parametrize(
    ("change", "code"), [("extend(b'1')", "EC907"), ("__setitem__(0, 50)", "EC907"), ("clear()", "EC107")]
)
def test_a_game_that_writes_to_its_marks_loses_only_its_own_verdict(change: str, code: str) -> None:
    game = (FIXTURES / "api" / "bad" / "crash_after_three.py").read_text().replace("bars[bar]", "bars[0]")
    forged = f"[each.{change} for each in type(self).step.__code__.co_consts if type(each).__name__ == 'Reached']"
    targets = [
        Target("game.py", game.replace("self.steps += 1", f"self.steps += 1\n        {line}").encode())
        for line in ("pass", forged)
    ]
    plan = Plan(targets, ARCADE, driver_named("process"), [Source(), Api(), SandboxEvents()], BUDGETS["quick"])
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    good, bad = (
        {finding.code for check in report.checks for finding in check.findings} for report in last.report.reports
    )
    assert good == set()
    assert code in bad
