"""Which files of a folder define environments, without running them, and what is said of one that defines none."""

from __future__ import annotations

import importlib
import json
import os
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from envcraft.environments.targets import environments_below, resolve
from envcraft.errors import UsageError
from envcraft.model.classes import environment_line
from tests.envcraft.conftest import ENVIRONMENT, Invoke

_ROOM = "class Room(gym.Env):\n    def reset(self, *, seed=None, options=None): ...\n    def step(self, action): ...\n"
_ABSTRACT = "class Game(gym.Env):\n    def step(self, action):\n        raise NotImplementedError\n"
_DECORATED = "class Game(gym.Env):\n    @abc.abstractmethod\n    def draw(self): ...\n"
_MADE = f"import gymnasium as gym\ndef build(size):\n{textwrap.indent(_ROOM, '    ')}    return Room\n"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        (f"import gymnasium as gym\n{_ROOM}", True),
        (f"import gym\n{_ROOM}", True),
        (_ROOM.replace("gym.Env", "Env").join(["from gymnasium import Env\n", ""]), True),
        ("import gymnasium.core\nclass Room(gymnasium.core.Env[int, int]): pass\n", True),
        ("from gymnasium import Env as Base\nclass A(Base): pass\n", True),
        (
            "try:\n    import gymnasium as gym\nexcept ImportError:\n    raise\nif True:\n    class A(gym.Env): pass\n",
            True,
        ),
        ("from gymnasium.envs.classic_control.cartpole import CartPoleEnv\nclass A(CartPoleEnv): pass\n", True),
        ("from minigrid.minigrid_env import MiniGridEnv\nclass A(MiniGridEnv): pass\n", True),
        ("import gymnasium as gym\nclass A(gym.Env):\n    def step(self\n", True),
        ("from games.base import Game\nclass Snake(Game): pass\n", True),
        ("from .base import Game\nclass Snake(Game): pass\n", True),
        ("from . import base\nclass Snake(base.Game): pass\n", True),
        ("import games.base\nclass Snake(games.base.Game): pass\n", True),
        ("from games import Game\nclass Snake(Game): pass\n", True),
        ("import gymnasium as gym\nclass Reward(gym.Wrapper):\n    def step(self, action): ...\n", False),
        ("import gymnasium as gym\nfrom torch import nn\nclass Net(nn.Module): pass\n", False),
        ("import gymnasium as gym\nclass TestGame:\n    def test(self): gym.make('CartPole-v1')\n", False),
        ("import gymnasium as gym\nenv = gym.make('CartPole-v1')\n", False),
        (f"import gymnasium as gym\n{_ABSTRACT}", False),
        (f"import abc\nimport gymnasium as gym\n{_DECORATED}", False),
        ("from games.loops import Loop\nclass Snake(Loop): pass\n", False),
        ("from games.tiles import Game\nclass Snake(Game): pass\n", False),
        ("from gymnasium.vector import VectorEnv\nclass Many(VectorEnv): pass\n", False),
        ("from pettingzoo import ParallelEnv\nclass Duel(ParallelEnv): pass\n", False),
        ("class A(A): pass\n", False),
        ("import gymnasium as gym\nRoot = gym.Env\nclass A(Root): pass\n", True),
        ("import gymnasium\ngym = gymnasium\nclass A(gym.Env): pass\n", True),
        ("try:\n    from gymnasium import Env\nexcept ImportError:\n    Env = object\nclass A(Env): pass\n", True),
        ("try:\n    from gymnasium import Env\nexcept ImportError:\n    class Env: ...\nclass A(Env): pass\n", True),
        ("from games.base import Game\nclass Game(Game): pass\n", True),
        ("from gymnasium import *\nclass A(Env): pass\n", True),
        ("from gymnasium.envs.toy_text import *\nclass A(FrozenLakeEnv): pass\n", True),
        ("from games.base import *\nclass A(Game): pass\n", True),
        ("from games.tiles import *\nclass A(Game): pass\n", False),
        ("from gymnasium import *\nclass A(Wrapper):\n    def reset(self): ...\n    def step(self, a): ...\n", False),
        ("import gymnasium as gym\ndef make(): return gym.Env\nclass A(make()): pass\n", True),
        (f"{_MADE}Base = build(3)\nclass A(Base): pass\n", True),
        ("from games.made import make\nclass A(make()): pass\n", True),
        ("def make(): return make()\nclass A(make()): pass\n", False),
        ("import gymnasium as A\nA = A.b\nA = A.c\nclass B(A): pass\n", False),
        ("from six import with_metaclass\nimport gymnasium\nclass A(with_metaclass(M, gymnasium.Env)): pass\n", True),
        (f"import gymnasium as gym\nimport lib\n{_ROOM}".replace("gym.Env", "lib.make()"), True),
        (f"import gymnasium as gym\nimport lib\n{_ROOM}".replace("gym.Env", "lib.make_wrapper(gym.Env)"), False),
        (f"import lib\n{_ROOM}".replace("gym.Env", "lib.make()"), False),
        ("import gymnasium\nfrom collections import namedtuple\nclass A(namedtuple('A', 'env, step')): pass\n", False),
        ("import gymnasium\nimport lib\nclass A(lib.make()):\n    def step(self): ...\n", False),
        ("import gymnasium\nRoom = type('Room', (gymnasium.Env,), {})\n", True),
        ("from games.base import Game\nRoom = type('Room', (Game,), {'step': step})\n", True),
        ("import gymnasium\nRoom = type('Other', (gymnasium.Env,), {})\n", False),
        ("import gymnasium\nRoom = type('Room', (gymnasium.Wrapper,), {})\n", False),
        ("import gymnasium\nkind = type(gymnasium.make('CartPole-v1'))\n", False),
        ("import gymnasium\nprint type(3)\n", False),
        (f"{_MADE}Room = build(3)\n", True),
        (f"{_MADE}Other = build(3)\n", False),
        (
            "import gymnasium\ndef build(name):\n    kind = type(name, (gymnasium.Env,), {})\n    return kind\n"
            "Room = build('Room')\n",
            True,
        ),
        ("def build(): return build()\nRoom = build()\nclass A: pass\n", False),
        ("", False),
    ],
)
def test_a_subclass_of_env_is_found(source: str, expected: bool, tmp_path: Path) -> None:
    games = tmp_path / "games"
    games.mkdir()
    (games / "__init__.py").write_text("from .base import Game\n")
    (games / "base.py").write_text(f"import gymnasium as gym\n{_ABSTRACT}")
    (games / "tiles.py").write_text("class Game: pass\n")
    (games / "made.py").write_text("def make():\n    from .base import Game\n    return Game\n")
    (games / "loops.py").write_text("from .loops import Loop\nclass Ring(Loop): pass\n")
    assert (environment_line(source.encode(), games / "snake.py") is not None) is expected


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A project with an environment and three files that use it."""
    folder = tmp_path / "project"
    (folder / "tests").mkdir(parents=True)
    (folder / "walk.py").write_text(ENVIRONMENT)
    (folder / "train.py").write_text("import gymnasium as gym\nimport walk\n\nclass Net:\n    env = walk.Walk()\n")
    (folder / "wrappers.py").write_text("import gymnasium as gym\n\nclass Slow(gym.Wrapper):\n    pass\n")
    (folder / "tests" / "test_env.py").write_text("import gymnasium as gym\n\nclass TestWalk:\n    pass\n")
    return folder


@pytest.mark.parametrize("command", ["validate", "audit"])
def test_files_without_an_environment_are_passed_over_and_counted(command: str, invoke: Invoke, project: Path) -> None:
    result = invoke(command, project, "--sandbox", "process", "--budget", "quick", "--checks", "source")
    assert result.exit_code == 0, result.output
    assert "skipped 3 files without an environment" in result.stderr


_BASE = "import gymnasium as gym\nfrom typing import Generic, TypeVar\nT = TypeVar('T')\n\n"
_METHODS = "    def reset(self, **kwargs): ...\n    def step(self, action): ...\n"
_SEES = """class Base(gym.Env):
    def reset(self, **kwargs): ...
    def step(self, action): return self._look()
    def _look(self): return self._see()
    def _see(self): raise NotImplementedError
"""


@pytest.mark.parametrize(
    ("base", "found"),
    [
        ("class Base(gym.Env[int, int]): ...", ["walk"]),
        ("class Base(gym.Env, Generic[T]):\n    def reset(self, **kwargs): ...", ["walk"]),
        ("class Root(gym.Env): ...\nclass Base(Root): ...", ["walk"]),
        ("class Base(gym.Env): ...\nclass Own(Base): ...", ["base", "walk"]),
        (f"class Base(gym.Env): ...\nclass Whole(Base):\n{_METHODS}", ["base", "walk"]),
        (f"class Base(gym.Env):\n{_METHODS}", ["base", "walk"]),
        ("class Base(gym.Env):\n    reset = step = print", ["base", "walk"]),
        (_SEES, ["walk"]),
        (_SEES.replace("self._see()", "Sight()"), ["base", "walk"]),
        (_SEES.replace("raise NotImplementedError", "return 0"), ["base", "walk"]),
        (f"{_SEES}class Whole(Base):\n    def _see(self): return 0", ["base", "walk"]),
        ("from minigrid.envs import EmptyEnv\nclass Base(EmptyEnv): ...", ["base", "walk"]),
        ("from mixins import Mixin\nclass Base(Mixin, gym.Env): ...", ["base", "walk"]),
        ("def made(kind): return kind\nclass Base(made(gym.Env)): ...", ["base", "walk"]),
    ],
)
def test_a_base_that_only_others_complete_is_passed_over(base: str, found: list[str], tmp_path: Path) -> None:
    (tmp_path / "base.py").write_text(f"{_BASE}{base}\n")
    (tmp_path / "walk.py").write_text(f"from base import Base\nclass Walk(Base):\n{_METHODS}")
    assert [Path(target.path).stem for target in environments_below(str(tmp_path))] == found
    (tmp_path / "walk.py").write_text(f"{_BASE}class Walk(gym.Env):\n{_METHODS}")
    assert [Path(target.path).stem for target in environments_below(str(tmp_path))] == ["base", "walk"]
    assert resolve(str(tmp_path / "base.py"))


def test_a_file_that_cannot_be_read_is_not_passed_over(invoke: Invoke, project: Path) -> None:
    # Reading the first byte of a process's memory fails, for the superuser too.
    (project / "hidden.py").symlink_to("/proc/self/mem")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source")
    result = invoke("validate", project, *options, "--format", "json")
    assert result.exit_code == 2
    assert f"Error: {project / 'hidden.py'} cannot be read" in result.stderr
    assert [Path(report["path"]).name for report in json.loads(result.stdout)["reports"]] == ["walk.py"]
    refused = invoke("audit", project, *options)
    assert (refused.exit_code, "hidden.py cannot be read" in refused.stderr) == (2, True)
    assert invoke("validate", project, *options, "--exclude", "hidden.py").exit_code == 0


def test_a_folder_that_cannot_be_read_is_not_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    tmp_path.chmod(0o755)
    Path("closed").mkdir(0)
    user = os.geteuid()
    # Another user may not be able to import it.
    importlib.import_module("envcraft.corpus.store")
    errors: dict[str, UsageError] = {}
    try:
        if not user:
            # The superuser reads every folder.
            os.seteuid(65534)
        found = list(environments_below(".", unreadable=errors.__setitem__))
    finally:
        os.seteuid(user)
        Path("closed").chmod(0o755)
    assert not found
    assert list(errors) == ["./closed"]
    assert str(errors["./closed"]) == "./closed cannot be read: Permission denied"


def test_a_file_that_is_named_twice_is_judged_once(
    invoke: Invoke, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(project)
    result = invoke("validate", "walk.py", "./walk.py", ".", "--sandbox", "process", "--checks", "source", "-q")
    assert "1 passed, 0 failed" in result.stdout


def test_an_interrupted_run_of_a_folder_says_what_keeps_verdicts(
    invoke: Invoke, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> Iterator[object]:
        yield from ()
        raise KeyboardInterrupt

    monkeypatch.setattr("envcraft.judging.engine.validate", interrupted)
    (project / "other.py").write_text(ENVIRONMENT)
    result = invoke("validate", project, "--sandbox", "process")
    assert result.exit_code == 130
    assert "none was judged; `envcraft audit FOLDER` stores each verdict and resumes" in result.stderr
    alone = invoke("validate", project / "walk.py", "--sandbox", "process")
    assert (alone.exit_code, "audit" in alone.stderr) == (130, False)


def test_the_hook_passes_named_files_over_and_a_named_file_is_judged(invoke: Invoke, project: Path) -> None:
    named = ("validate", project / "walk.py", project / "train.py", project / "wrappers.py")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--format", "json")
    result = invoke(*named, *options, "--environments-only")
    assert result.exit_code == 0, result.output
    assert [Path(report["path"]).name for report in json.loads(result.stdout)["reports"]] == ["walk.py"]
    assert invoke(*named, *options).exit_code == 1


def test_the_hook_passes_over_a_base_class_of_files_that_it_was_not_given(invoke: Invoke, project: Path) -> None:
    base, unfinished = project / "base.py", "import gymnasium as gym\n\n\nclass {}(gym.Env):\n    size = 8\n"
    base.write_text(unfinished.format("Base"))
    (project / "derived.py").write_text(
        "import gymnasium as gym\nfrom base import Base\n\n\nclass Derived(Base): ...\n"
    )
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--environments-only")
    result = invoke("validate", base, project / "walk.py", *options)
    assert result.exit_code == 0, result.output
    assert f"skipped 1 file without an environment: {base}" in result.stderr
    # Nothing derives from this one, so its author has forgotten the methods.
    base.write_text(unfinished.format("Forgotten"))
    assert invoke("validate", base, project / "walk.py", *options).exit_code == 1


def test_a_null_byte_has_a_line(invoke: Invoke, good: Path) -> None:
    good.write_bytes(b"import gymnasium\nx = 1\0\n")
    result = invoke("validate", good, "--sandbox", "process", "--format", "concise")
    assert f"{good}:2: EC001" in result.stdout
    assert "(line None)" not in result.stdout


def test_an_encoding_that_python_does_not_know_has_a_line(invoke: Invoke, good: Path) -> None:
    good.write_text(f"#!/usr/bin/python\n# -*- coding: klingon -*-\n{ENVIRONMENT}")
    result = invoke("validate", good, "--sandbox", "process", "--format", "concise")
    assert f"{good}:2: EC001 unknown encoding: klingon" in result.stdout


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (
            f"import abc\nimport gymnasium as gym\n{_DECORATED}{_ROOM.partition(chr(10))[2]}",
            "Game leaves draw() abstract",
        ),
        (_ROOM.replace("(gym.Env)", ""), "Room has reset and step but does not derive from gymnasium.Env"),
        (
            f"{_MADE}Other = build(3)\n",
            "build() makes the class Room: name it with --class Other",
        ),
        (_MADE, "build() makes the class Room: define it at the top level"),
    ],
)
def test_a_class_that_is_no_environment_is_named_with_its_line(
    source: str, words: str, invoke: Invoke, good: Path
) -> None:
    good.write_text(source)
    result = invoke("validate", good, "--sandbox", "process", "--format", "concise")
    line = source.split("class ")[0].count("\n") + 1
    assert f"{good}:{line}: EC005" in result.stdout
    assert words in result.stdout


#: A file without a class statement.
_ASSIGNED = """import gymnasium as gym
from gymnasium import spaces


def start(self, size):
    self.observation_space = self.action_space = spaces.Discrete(3)


def reset(self, *, seed=None, options=None):
    return 0, {}


def step(self, action):
    return 0, 0.0, True, False, {}


Env = type("Env", (gym.Env,), {"__init__": start, "reset": reset, "step": step})
"""


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (_ASSIGNED, f"{_ASSIGNED[: _ASSIGNED.index('def start')].count(chr(10)) + 1}: EC007"),
        (f"{_ASSIGNED}Two = type('Two', (Env,), {{}})\n", f"{_ASSIGNED.count(chr(10)) + 1}: EC006"),
    ],
)
def test_a_class_that_is_only_assigned_is_judged_in_its_folder(
    text: str, place: str, invoke: Invoke, good: Path
) -> None:
    good.write_text(text)
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--contract", "gymnasium")
    result = invoke("validate", ".", *options, "--format", "concise")
    assert f"./walk.py:{place}" in result.stdout, result.output


def test_a_class_that_lacks_a_method_is_named_with_its_line(invoke: Invoke, good: Path) -> None:
    good.write_text(
        "import gymnasium as gym\n\nclass Game(gym.Env):\n    def reset(self, *, seed=None, options=None): ...\n"
    )
    result = invoke("validate", good, "--sandbox", "process", "--format", "concise")
    assert f"{good}:3: EC005" in result.stdout
    assert "Game has no step" in result.stdout


_GOAL = "import abc\nimport gymnasium as gym\n\n" + _ROOM.replace("Room(gym.Env)", "Base(gym.Env, abc.ABC)")
_GOAL += "    @abc.abstractmethod\n    def goal(self): ...\n"


@pytest.mark.parametrize(
    ("base", "source", "words"),
    [
        (_GOAL, "from base import Base\n\nclass Grid(Base): ...\n", "3: Grid leaves goal() of Base abstract"),
        ("", f"{_GOAL}\nclass Grid(Base): ...\n", "10: Grid leaves goal() of Base abstract"),
        ("", _GOAL, "4: Base leaves goal() abstract"),
        (
            f"import gymnasium as gym\n{_ABSTRACT}",
            "from base import Game\nclass Grid(Game): ...\n",
            "2: Grid has no reset and leaves step() of Game abstract",
        ),
    ],
)
def test_a_class_that_inherits_an_abstract_method_is_named_with_its_line(
    base: str, source: str, words: str, invoke: Invoke, good: Path
) -> None:
    good.with_name("base.py").write_text(base)
    good.write_text(source)
    options = ("--sandbox", "process", "--contract", "gymnasium", "--format", "concise")
    result = invoke("validate", good, *options)
    line, _, hint = words.partition(": ")
    assert f"{good}:{line}: EC005" in result.stdout
    assert f"; {hint}" in result.stdout
