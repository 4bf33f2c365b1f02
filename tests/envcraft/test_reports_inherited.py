"""A finding about what another file defines names the class there, and a line of the user's file in every format."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from envcraft_checks.api import Api
from envcraft_checks.sandbox import SandboxEvents
from envcraft_checks.source import Source
from gymnasium.envs.classic_control.cartpole import CartPoleEnv

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.project import with_project
from envcraft.model.target import Target, read_target
from envcraft.model.verdict import Report
from envcraft.registry import offered
from envcraft.reports.console import ConsoleReporter
from envcraft.reports.reporter import Reporter
from envcraft.reports.sarif import SarifReporter
from tests.envcraft.report_samples import rendered

_GRID = """import gymnasium as gym
from gymnasium.envs.classic_control.cartpole import CartPoleEnv


class Grid(CartPoleEnv):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__(render_mode="human")
        self.render_mode = "something else"
        self.observation_space = gym.spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        _, reward, terminated, truncated, info = super().step(action)
        return 0, reward, terminated, truncated, info
"""
_CLASS = _GRID.splitlines().index("class Grid(CartPoleEnv):") + 1
_CONSTRUCTOR = 1 + next(number for number, text in enumerate(_GRID.splitlines()) if "def __init__" in text)
_OWNER = (
    f"gymnasium.envs.classic_control.cartpole.CartPoleEnv (cartpole.py:{CartPoleEnv.render.__code__.co_firstlineno})"
)


def _judged(target: Target, checks: Sequence[Check] = (Source(), Api())) -> Report:
    plan = Plan([target], GYMNASIUM, driver_named("process"), [*checks], BUDGETS["quick"])
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    return last.report


@pytest.fixture(scope="module")
def report() -> Report:
    return _judged(Target("grid.py", _GRID.encode()))


def test_the_finding_has_the_line_of_the_class_and_names_the_method(report: Report) -> None:
    found = [finding for check in report.reports[0].checks for finding in check.findings]
    lines = {finding.code: finding.line for finding in found}
    assert lines["EC112"] == _CLASS
    assert all(line is None or 1 <= line <= len(_GRID.splitlines()) for line in lines.values())
    (message,) = [finding.message for finding in found if finding.code == "EC112"]
    assert message.endswith(f"; render() is inherited from {_OWNER}")


def _sarif(text: str) -> bool:
    (result,) = [each for each in json.loads(text)["runs"][0]["results"] if each["ruleId"] == "EC112"]
    place = result["locations"][0]["physicalLocation"]
    return (place["artifactLocation"]["uri"], place["region"]["startLine"]) == ("grid.py", _CLASS)


def _json(text: str) -> bool:
    found = [finding for check in json.loads(text)["reports"][0]["checks"] for finding in check["findings"]]
    return [finding["line"] for finding in found if finding["code"] == "EC112"] == [_CLASS]


_PLACES: dict[str, Callable[[str], bool]] = {
    "sarif": _sarif,
    "json": _json,
    "github": lambda text: f"file=grid.py,line={_CLASS},title=EnvCraft EC112" in text,
}


@pytest.mark.parametrize("kind", offered("envcraft_reporters"), ids=lambda kind: kind.name)
def test_every_format_has_the_line_of_the_class(kind: type[Reporter], report: Report) -> None:
    text = rendered(kind, report)
    assert "CartPoleEnv" in text.partition("EC112")[2]
    in_place = _PLACES.get(kind.name)
    assert in_place(text) if in_place else f"grid.py:{_CLASS}" in text


def _in_package(folder: Path, base: str, source: str, name: str) -> Target:
    """A class of the file room.py, beside which base.py lies."""
    package = folder / "mazes"
    package.mkdir()
    for file, text in {"__init__.py": "", "base.py": f"# One line more.\n{base}", "room.py": source}.items():
        (package / file).write_text(text)
    return with_project(read_target(str(package / "room.py"), name))


def test_a_class_that_the_file_imports_has_the_line_of_the_import(tmp_path: Path) -> None:
    step = "    def step(self, action):\n"
    base = _GRID.replace(step, f"{step}        raise ValueError\n")
    report = _judged(_in_package(tmp_path, base, "from .base import Grid\n", "Grid"))
    found = {finding.code: finding for check in report.reports[0].checks for finding in check.findings}
    assert {code: finding.line for code, finding in found.items()} == {"EC107": 1, "EC112": 1, "EC116": 1}
    assert found["EC107"].message.endswith(f"; Grid is mazes.base.Grid (base.py:{_CLASS + 1})")
    assert found["EC112"].message.endswith(f"; render() is inherited from {_OWNER}")


@pytest.mark.parametrize(
    ("source", "name", "line"),
    [
        ("import numpy\nfrom .base import (\n    Grid as Room,\n)\n", "Room", 3),
        ("from .base import *\n", "Grid", 1),
        ("from . import base\n\nif base:\n    Room = base.Grid\n\n\ndef f():\n    Room = 0\n", "Room", 4),
        ("from . import base\n\nglobals().update(Room=base.Grid)\n", "Room", None),
        ("from .base import Grid\n\n\nclass Room(Grid):\n    pass\n", "Room", 4),
        (f"{_GRID}\n\nRoom = Grid\n", "Room", _CONSTRUCTOR),
    ],
)
def test_the_line_of_a_class_is_one_of_the_file(source: str, name: str, line: int | None, tmp_path: Path) -> None:
    base, source = (text.replace("render_mode=None", "size, render_mode=None") for text in (_GRID, source))
    report = _judged(_in_package(tmp_path, base, source, name), [Source()])
    (found,) = report.reports[0].checks[0].findings
    assert (found.code, found.line) == ("EC007", line)
    note = f"; {name} is mazes.base.Grid (base.py:{_CLASS + 1})"
    if "class " in source:
        own = "def __init__" in source
        note = "" if own else f"; __init__() is inherited from mazes.base.Grid (base.py:{_CONSTRUCTOR + 1})"
    assert found.message == f"{name}() needs size{note}"


_BASE = """import copy
import threading
import gymnasium as gym


class Base(gym.Env):
    observation_space = action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return 0, {}

    def step(self, action):
        nested = threading.Lock()
        for _ in range(9):
            nested = [nested]
        copy.deepcopy(nested)
"""
_COPIES = _BASE.splitlines().index("        copy.deepcopy(nested)") + 1


@pytest.fixture(scope="module")
def raising(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """A class of which another file raises, in a library that it calls."""
    folder = tmp_path_factory.mktemp("mazes")
    (folder / "base.py").write_text(_BASE)
    (folder / "room.py").write_text("from base import Base\n\n\nclass Room(Base):\n    pass\n")
    return _judged(with_project(read_target(str(folder / "room.py"))))


@pytest.mark.parametrize("kind", offered("envcraft_reporters"), ids=lambda kind: kind.name)
def test_every_format_names_the_line_of_another_file_that_raises(kind: type[Reporter], raising: Report) -> None:
    assert f"base.py line {_COPIES}" in rendered(kind, raising)


def test_sarif_relates_the_line_of_another_file_that_raises(raising: Report) -> None:
    [result] = json.loads(rendered(SarifReporter, raising))["runs"][0]["results"]
    [related] = [each["physicalLocation"] for each in result["relatedLocations"]]
    assert Path(related["artifactLocation"]["uri"]).name == "base.py"
    assert related["region"] == {"startLine": _COPIES}
    [finding] = [finding for check in raising.reports[0].checks for finding in check.findings]
    assert (finding.evidence["file"], finding.evidence["file_line"]) == ("base.py", _COPIES)


def test_a_limit_that_another_file_reaches_is_shown_with_its_line(tmp_path: Path) -> None:
    step = "    def step(self, action):\n"
    base = _GRID.replace(step, f"{step}        raise MemoryError\n")
    line = 1 + base.splitlines().index("        raise MemoryError")
    (tmp_path / "base.py").write_text(base)
    (tmp_path / "room.py").write_text("from base import Grid\n\n\nclass Room(Grid):\n    pass\n")
    report = _judged(with_project(read_target(str(tmp_path / "room.py"))), [Source(), Api(), SandboxEvents()])
    found = [finding for check in report.reports[0].checks for finding in check.findings if finding.code == "EC902"]
    assert [(each.evidence["file"], each.evidence["file_line"]) for each in found] == [("base.py", line)]
    assert f'File "base.py", line {line}, in step' in rendered(ConsoleReporter, report)
    results = json.loads(rendered(SarifReporter, report))["runs"][0]["results"]
    [related] = [result["relatedLocations"] for result in results if result["ruleId"] == "EC902"]
    assert related[0]["physicalLocation"]["region"] == {"startLine": line}


def test_however_deep_a_library_raises_the_traceback_has_the_line_that_calls_it(raising: Report) -> None:
    [finding] = [finding for check in raising.reports[0].checks for finding in check.findings]
    assert (finding.code, finding.line) == ("EC107", 4)
    files = re.findall(r'File "(.*?)", line (\d+)', finding.evidence["traceback"])
    assert files[0] == ("base.py", str(_COPIES))
    assert {name.rpartition("/")[2] for name, _ in files[1:]} == {"copy.py"}


def test_the_line_of_another_file_that_the_file_calls_is_named(tmp_path: Path) -> None:
    (tmp_path / "helper.py").write_text("def check(size):\n    assert size, 'no size'\n")
    source = _GRID.replace("        super().__init__", "        helper.check(0)\n        super().__init__")
    (tmp_path / "grid.py").write_text(f"import helper\n{source}")
    report = _judged(with_project(read_target(str(tmp_path / "grid.py"))))
    [finding] = [finding for check in report.reports[0].checks for finding in check.findings]
    assert (tmp_path / "grid.py").read_text().splitlines()[(finding.line or 0) - 1].strip() == "helper.check(0)"
    assert finding.message == f"Grid() raises AssertionError in {tmp_path}/helper.py line 2: no size"
