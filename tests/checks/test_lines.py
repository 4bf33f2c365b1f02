"""A finding names a line of the file wherever one is known."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from envcraft_checks.api import Api
from envcraft_checks.endings.flags import flag_line
from envcraft_checks.linting.generators import anew, constant_seed
from envcraft_checks.linting.program import Program

import envcraft
from envcraft.contracts.builtin import ARCADE, GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan
from envcraft.judging.selection import driver_named, select_checks
from envcraft.model.contract import Contract
from envcraft.model.project import with_project
from envcraft.model.target import Target
from envcraft.model.verdict import Finding
from evaluation.judge import judge_plans

GAME = """
import gymnasium as gym
import numpy as np


class Game(gym.Env):
    observation_space = gym.spaces.Discrete(9)
    action_space = gym.spaces.Discrete(2)

    def __init__(self):
        self.at = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = int(self.np_random.integers(3))
        return self.at, {}

    def step(self, action):
        self.at += int(action)
        return self.at, 1.0, self.at == 8, False, {}
"""


#: Instead of the class above: a vector that step() changes and returns.
_VECTOR = """
    observation_space = gym.spaces.Box(0, 99, (2,), float)
    action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.cells = self.np_random.random(2)
        return self.cells, {}

    def step(self, action):
        action = int(action)
        self.cells += 0.5
        return self.cells, float(action), bool(self.cells[0] > 9), False, {}


class _Old(gym.Env):"""
#: A buffer that a method fills and returns.
_DRAWN = """
    observation_space = gym.spaces.Box(0, 99, (2,), float)
    action_space = gym.spaces.Discrete(2)

    def __init__(self):
        self.cells = np.zeros(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at = int(self.np_random.integers(3))
        return self._look(), {}

    def step(self, action):
        self.at += 1
        return self._look(), float(action), self.at > 20, False, {}

    def _look(self):
        cells = self.cells
        cells[:] = self.at
        return cells


class _Old(gym.Env):"""
_FRESH = _DRAWN.replace("cells = self.cells", "cells = np.zeros(2)")
_KEPT = _FRESH.replace("return cells", "self.cells = cells\n        return cells")
_KEPT = _KEPT.replace("self.at = int", "self.cells[:] = 0\n        self.at = int")
_TYPED = _FRESH.replace("return cells", "return cells.astype(object)")
_NAMELESS = _DRAWN.replace("np.zeros(2)", "[np.zeros(2)] * 2").replace("= self.cells", "= self.cells[self.at % 2]")
_MORE = "1.0, self.at == 8, False, {}"
_LAST = f"return self.at, {_MORE}"
_LOOK = "\n\n    def _look(self):\n"
_TEXT = f"{_LOOK}        return str(self.at)\n"
_SEEN, _FEW = (_TEXT.replace("str(self.at)", value) for value in ("self.at", "self.at, 1.0, {}"))
_EITHER = f"{_LOOK}        if self.at:\n            return 'one'\n        return 'none'\n"


@pytest.mark.parametrize(
    ("old", "new", "code", "named"),
    [
        ("return self.at, {}", "return self.at + 9, {}", "EC109", "return self.at + 9, {}"),
        ("return self.at, 1.0", "return self.at + 9, 1.0", "EC109", "return self.at + 9, 1.0"),
        ("return self.at, 1.0", "return str(self.at), 1.0", "EC108", "return str(self.at), 1.0"),
        ("return self.at, {}", "return self.at, {3: 4}", "EC114", "return self.at, {3: 4}"),
        ("self.at == 8, False, {}", "self.at == 8, False, 3", "EC114", "self.at == 8, False, 3"),
        ("return self.at, {}", "return self.at", "EC105", "return self.at"),
        ("Game(gym.Env):", f"Game(gym.Env):{_VECTOR}", "EC110", "self.cells += 0.5"),
        ("Game(gym.Env):", f"Game(gym.Env):{_DRAWN}", "EC110", "cells[:] = self.at"),
        ("Game(gym.Env):", f"Game(gym.Env):{_KEPT}", "EC110", "self.cells[:] = 0"),
        ("Game(gym.Env):", f"Game(gym.Env):{_NAMELESS}", "EC110", "return cells"),
        ("Game(gym.Env):", f"Game(gym.Env):{_TYPED}", "EC108", "return cells.astype(object)"),
        (
            "return self.at, {}",
            f"seen = self._look()\n        return seen, {{}}{_TEXT}",
            "EC108",
            "return str(self.at)",
        ),
        (_LAST, _LAST.replace("self.at", "self._look()", 1) + _EITHER, "EC108", "return self._look(), 1.0"),
        (
            _LAST,
            f"if self.at:\n            return self._look(), {_MORE}\n        return self._look(), {_MORE}{_TEXT}",
            "EC108",
            "return str(self.at)",
        ),
        (_LAST, _LAST.replace("{}", "self._look()") + _TEXT, "EC114", "return str(self.at)"),
        ("self.at == 8, False, {}", "self.at == 8, {}", "EC106", "self.at == 8, {}"),
        # The method that makes the observation is right.
        (
            "return self.at, {}",
            f"return self._look(){_SEEN}",
            "EC105",
            "self._look()",
        ),
        (_LAST, f"return self._look(){_SEEN}", "EC106", "self._look()"),
        (_LAST, f"return self._look(){_FEW}", "EC106", "self.at, 1.0, {}"),
        (
            "return self.at, 1.0",
            "if self.at == 3:\n            return 3\n        return self.at, 1.0",
            "EC106",
            "return 3",
        ),
        # What returns at the end of the episode is right.
        *(
            (
                _LAST,
                f"if self.at == 8:\n            return self.at, 0.0, self.at > 0, False, {{}}\n        {last}",
                *found,
            )
            for last, *found in (
                ("return self.at, 1.0, self.at == 8, {}", "EC106", "self.at == 8, {}"),
                ("return str(self.at), 1.0, False, False, {}", "EC108", "return str(self.at)"),
                ("return self.at + 9, 1.0, False, False, {}", "EC109", "return self.at + 9"),
                ("return self.at, 1.0, False, False, None", "EC114", "False, False, None"),
            )
        ),
        ("self.at = 0", "import os; os._exit(3)", "EC008", "class Game"),
        ("", "\n\nclass Other(Game):\n    pass\n", "EC006", "class Other"),
        ("__init__(self)", "__init__(self, size)", "EC007", "def __init__"),
    ],
)
def test_the_line_of_a_finding(old: str, new: str, code: str, named: str) -> None:
    text = GAME.replace(old, new, 1) if old else GAME + new
    assert named in text.splitlines()[(lines(text)[code] or 0) - 1]


_PAIR = GAME.replace("Discrete(2)", "MultiDiscrete([3, 3])").replace("int(action)", "int(action[0])")
_WRITES = "_clip(self, given):\n        given[1] = 0\n\n    def step"


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("self.at += int(", "action[1] = 0\n        self.at += int(", "action[1] = 0"),
        ("self.at += int(", "action *= 0\n        self.at += int(", "action *= 0"),
        ("self.at += int(", "np.clip(action, 0, 0, out=action)\n        self.at += int(", "np.clip("),
        (
            "step(self, action):",
            f"{_WRITES}(self, action):\n        self._clip(action)",
            "given[1] = 0",
        ),
        # What writes into the copy is right.
        (
            "step(self, action):",
            f"{_WRITES}(self, action):\n        self._clip(action)\n"
            "        action = action.copy()\n        action[0] = 0",
            "given[1] = 0",
        ),
        (
            "step(self, action):",
            "step(self, action):\n        (lambda one: one.fill(0))(action)\n        action = action.copy()\n"
            "        action[0] = 0",
            "def step",
        ),
    ],
)
def test_the_line_that_writes_into_the_action(old: str, new: str, named: str) -> None:
    text = _PAIR.replace(old, new, 1)
    assert named in text.splitlines()[(lines(text)["EC111"] or 0) - 1]


_SWALLOWED = "        try:\n            self.at += int(action)\n        except Exception:\n            pass\n"
_BROKEN = GAME.replace("        self.at += int(action)\n", _SWALLOWED).replace("self.at, 1.0", "self.at + 9, 1.0")
#: Two environments with the same defects.
_TWO = _BROKEN + _BROKEN.partition("gym\n")[2].replace("class Game", "class Other")


@pytest.mark.parametrize(
    ("alias", "judged"),
    [
        ("Env = Game", "Game"),
        ("Env = Other", "Other"),
        ("Env = [Game, Other][0]", "Game"),
        ("class Env(Game):\n    pass", "Game"),
        ("def choose():\n    return Game\n\n\nEnv = choose()", "Game"),
    ],
)
def test_a_line_is_one_of_the_class_that_an_alias_names(alias: str, judged: str) -> None:
    text = f"{_TWO}\n\n{alias}\n"
    found = lines(text, checks="source,api,lint", env_class="Env")
    first = text.splitlines().index(f"class {judged}(gym.Env):") + 1
    inside = range(first, first + _BROKEN.count("\n"))
    assert (found["EC058"] in inside, found["EC109"] in inside) == (True, True), found


def test_no_line_is_one_of_another_class_than_the_imported_one(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text(_BROKEN)
    text = _BROKEN.replace("class Game", "class Other") + "\n\nfrom beside import Game as Env\n"
    found = lines(text, checks="source,api,lint", env_class="Env", path=str(tmp_path / "game.py"))
    assert found == {"EC109": text.count("\n")}


def lines(
    text: str,
    contract: Contract = GYMNASIUM,
    checks: str = "source,api",
    env_class: str | None = None,
    path: str = "game.py",
) -> dict[str, int | None]:
    """The line of each finding by its code."""
    target = with_project(Target(path, text.encode(), env_class))
    plan = Plan([target], contract, driver_named("process"), select_checks(checks, None), BUDGETS["quick"])
    [[_, report]] = judge_plans([plan])
    return {finding.code: finding.line for check in report.checks for finding in check.findings}


_OBSERVATION, _ACTION = "observation_space = gym.spaces.Discrete(9)", "action_space = gym.spaces.Discrete(2)"
_CLASS = f"    {_OBSERVATION}\n    {_ACTION}\n\n"
_IN_CONSTRUCTOR = GAME.replace(_CLASS, "").replace(
    "        self.at = 0\n", f"        self.{_OBSERVATION}\n        self.at = 0\n        self.{_ACTION}\n", 1
)


@pytest.mark.parametrize(
    ("text", "observation", "action"),
    [
        (GAME, _OBSERVATION, _ACTION),
        (_IN_CONSTRUCTOR, f"self.{_OBSERVATION}", f"self.{_ACTION}"),
        (
            _IN_CONSTRUCTOR.replace("Game", "_Game") + "\n\nclass Far(_Game):\n    pass\n",
            f"self.{_OBSERVATION}",
            f"self.{_ACTION}",
        ),
        (
            _IN_CONSTRUCTOR.replace("__init__(self)", "__init__(self, wide=False)").replace(
                f"self.{_OBSERVATION}", f"self.{_OBSERVATION}\n        if wide:\n            self.{_OBSERVATION}"
            ),
            "def __init__",
            f"self.{_ACTION}",
        ),
        (
            GAME.replace(
                f"    {_ACTION}\n",
                "    @property\n    def action_space(self):\n        return gym.spaces.Discrete(2)\n",
            ),
            _OBSERVATION,
            "def action_space",
        ),
        (GAME.replace(_CLASS, "") + f"\n\nGame.{_OBSERVATION}\nGame.{_ACTION}\n", "def __init__", "def __init__"),
    ],
    ids=["class", "constructor", "base", "two lines", "property", "elsewhere"],
)
def test_the_line_of_a_space_of_another_contract(text: str, observation: str, action: str) -> None:
    found = {code: text.splitlines()[(line or 0) - 1].strip() for code, line in lines(text, ARCADE).items()}
    assert found["EC101"].startswith(observation)
    assert found["EC102"].startswith(action)


_RENDERED = GAME.replace("    def __init__(self):", "    def render(self):\n        pass\n\n    def __init__(self):")


def _only(text: str, code: str) -> Finding:
    """The only finding with a code that the first two checks report under the contract gymnasium."""
    plan = Plan(
        [Target("game.py", text.encode())],
        GYMNASIUM,
        driver_named("process"),
        select_checks("source,api", None),
        BUDGETS["quick"],
    )
    [[_, report]] = judge_plans([plan])
    [found] = [finding for check in report.checks for finding in check.findings if finding.code == code]
    return found


@pytest.mark.parametrize(
    ("metadata", "named", "words"),
    [
        ("", "class Game", 'metadata["render_modes"] is empty or absent; metadata has no "render_fps"'),
        (
            'metadata = {"render_modes": ["ansi"]}',
            "metadata",
            'the constructor does not take render_mode; metadata has no "render_fps", which Gymnasium expects beside '
            '"render_modes"',
        ),
        ('metadata = {"render_modes": ["ansi"], "render_fps": 4}', "def __init__", "does not take render_mode"),
        (
            'metadata = {"render.modes": ["human"], "video.frames_per_second": 30}',
            "metadata",
            'metadata has "render.modes", which Gymnasium calls "render_modes"; '
            'metadata has "video.frames_per_second", which Gymnasium calls "render_fps"',
        ),
    ],
)
def test_a_finding_about_metadata_has_its_line(metadata: str, named: str, words: str) -> None:
    text = _RENDERED.replace("    observation_space", f"    {metadata}\n    observation_space", 1)
    found = _only(text, "EC116")
    assert words in found.message
    assert text.splitlines()[(found.line or 0) - 1].strip().startswith(named)
    assert "rgb_array" not in Api().rule("EC116").fix


def test_a_misspelt_space_is_named() -> None:
    text = GAME.replace("observation_space", "obervation_space")
    found = _only(text, "EC101")
    assert found.message == "Game has no observation_space, but obervation_space; correct this name"
    assert "obervation_space =" in text.splitlines()[(found.line or 0) - 1]


@pytest.mark.parametrize("value", ["'no'", "str(False)", "[]"])
def test_success_that_is_no_bool_is_named(value: str) -> None:
    text = GAME.replace("self.at == 8, False, {}", f"self.at == 8, False, {{'is_success': {value}}}")
    assert "False, {'is_success'" in text.splitlines()[(lines(text)["EC114"] or 0) - 1]


@pytest.mark.parametrize(
    ("body", "flag", "named"),
    [
        ("done = int(self.at == 8)\nreturn self.at, 1.0, done, False, {}", "terminated", "done = int(self.at == 8)"),
        ("return self.at, 1.0, self.at == 8, 0, {}", "truncated", "return self.at, 1.0, self.at == 8, 0, {}"),
        (
            "done = False\nif self.at == 8:\n    done = 1\nreturn self.at, 1.0, done, False, {}",
            "terminated",
            "done = 1",
        ),
        ("return self.at, 1.0, not self.at or self.at == 8, False, {}", "terminated", None),
        ("done = 1\nif self.at:\n    done = 0\nreturn self.at, 1.0, done, False, {}", "terminated", None),
    ],
)
def test_the_line_that_makes_a_flag(body: str, flag: str, named: str | None) -> None:
    old = "self.at += int(action)\n        return self.at, 1.0, self.at == 8, False, {}"
    source = GAME.replace(old, body.replace("\n", "\n        "))
    line = flag_line(Program(ast.parse(source)), flag)
    assert (source.splitlines()[line - 1].strip() if line else None) == named


def test_the_line_that_gave_a_flag_its_value_in_the_call() -> None:
    guard = "if self.at == 7:\n            return self.at, 0.0, self.over, False, {}"
    text = GAME.replace(_LAST, f"{guard}\n        return self.at, 1.0, int(self.at == 8), False, {{}}")
    text = text.replace("self.at = 0", "self.at, self.over = 0, True")
    report = envcraft.validate(text, contract="gymnasium", sandbox="process", budget="quick", checks="termination")
    [found] = [found for check in report.reports[0].checks for found in check.findings if found.code == "EC504"]
    assert "int(self.at == 8)" in text.splitlines()[(found.line or 0) - 1]


@pytest.mark.parametrize(
    ("call", "named"),
    [
        ("super().reset(seed=42)", "super().reset(seed=42)"),
        ("super().reset(seed=seed or 7)", "super().reset(seed=seed or 7)"),
        ("super().reset(seed=SEED)", "super().reset(seed=SEED)"),
        ("if seed is None:\n    seed = 3\nsuper().reset(seed=seed)", "seed = 3"),
        ("super().reset(seed=seed)\nself._np_random = np.random.default_rng(0)", "self._np_random = np.random.def"),
        ("super().reset(seed=seed)\nself.clock.reset(0)", None),
        ("super().reset(seed=seed)", None),
    ],
)
def test_the_line_that_fixes_the_seed(call: str, named: str | None) -> None:
    source = GAME.replace("super().reset(seed=seed)", call.replace("\n", "\n        "))
    found = constant_seed(Program(ast.parse(source)))
    assert (source.splitlines()[found.line - 1].strip() if found else "").startswith(named or "")
    assert bool(found) == bool(named)


@pytest.mark.parametrize(
    ("seeding", "named"),
    [
        ("self.rng = np.random.default_rng(seed)", "default_rng(seed)"),
        ("self.rng.seed(seed)", "self.rng.seed(seed)"),
        (
            "if seed is not None:\n            self.rng = np.random.default_rng(seed)\n"
            "        else:\n            self.rng = np.random.default_rng()",
            "default_rng()",
        ),
        ("self.rng = np.random.default_rng(seed)\n        self.other = np.random.default_rng(seed)", None),
        ("self.rng = np.random.default_rng(3)", None),
        ("pass", None),
    ],
)
def test_the_line_that_makes_a_generator_anew_without_a_seed(seeding: str, named: str | None) -> None:
    source = GAME.replace("self.at = int(", f"{seeding}\n        self.at = int(", 1)
    found = anew(Program(ast.parse(source)))
    if named is None:
        assert found is None
    else:
        assert found is not None
        assert source.splitlines()[found.line - 1].strip().endswith(named)
        assert found.words.startswith("takes new numbers from the system where there is no seed: ")


_CORRIDOR = """
import gymnasium as gym
import numpy as np


class Corridor(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = gym.spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = gym.spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.steps = 5, 0
        return self.render(), {}

    def step(self, action):
        self.at = (self.at + int(action[0]) - 2) % 84
        self.steps += 1
        LAST

    def render(self):
        return np.full((84, 84, 3), self.at, np.uint8)
"""


@pytest.mark.parametrize(
    ("last", "named"),
    [
        ("return self.render(), 0.0, self.steps == 60, False, {}", "self.steps == 60"),
        ("return self.render(), 0.0, False, self.steps == 60, {}", "self.steps == 60"),
        ("won = self.steps == 60\n        return self.render(), 0.0, won, False, {}", "won = self.steps == 60"),
        (
            "won = self.steps == 60\n        won = bool(won)\n        return self.render(), 0.0, won, False, {}",
            "return",
        ),
    ],
)
def test_an_episode_that_goes_on_names_what_decides_its_end(last: str, named: str) -> None:
    text = _CORRIDOR.replace("LAST", last)
    report = envcraft.validate(text, sandbox="process", budget="quick", checks="termination")
    [found] = [found for check in report.reports[0].checks for found in check.findings if found.code == "EC505"]
    assert named in text.splitlines()[(found.line or 0) - 1]
