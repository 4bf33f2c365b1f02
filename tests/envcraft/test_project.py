"""Which files of a folder define environments, without running them."""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from envcraft_checks.libraries import why_unknown

import envcraft
from envcraft.contracts.builtin import GYMNASIUM
from envcraft.environments.targets import environments_below, resolve
from envcraft.errors import UsageError
from envcraft.model.classes import defining_file, environment_line
from envcraft.model.import_folders import import_folders
from envcraft.model.project import with_project
from envcraft.model.target import Kind, Target
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


def _below(folder: Path, path: str, source: str, root: Path | None = None) -> dict[str, bytes]:
    """The files that a file of a folder needs."""
    project = with_project(Target(str(folder / path), source.encode()), root).project
    return project.files if project is not None else {}


@pytest.mark.parametrize(
    "line",
    [
        "LEVEL = (Path(__file__).parent.parent.parent / 'data' / 'level.txt').read_text()",
        "LEVEL = Path(__file__).parents[2].joinpath('data/level.txt').read_text()",
        "LEVEL = open(os.path.join(os.path.dirname(__file__), '..', '..', 'data', 'level.txt')).read()",
        "LEVEL = open(os.path.dirname(__file__) + '/../../data/level.txt').read()",
        "from importlib.resources import files\nLEVEL = files('zz_games.inner').joinpath('level.txt').read_text()",
    ],
)
def test_data_of_the_project_beside_its_packages_is_found(
    line: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("pyproject.toml").write_text("[project]\nname = 'zz_games'\n")
    Path("src/zz_games").mkdir(parents=True)
    Path("src/zz_games/__init__.py").touch()
    Path("src/zz_games/sizes.py").write_text(f"import os\nfrom pathlib import Path\n\n{line}\n")
    Path("src/zz_games/walk.py").write_text(
        f"from zz_games.sizes import LEVEL\n\nassert LEVEL == 'seven'\n{ENVIRONMENT}"
    )
    Path("data").mkdir()
    Path("data/level.txt").write_text("seven")
    Path("src/zz_games/inner").mkdir()
    Path("src/zz_games/inner/level.txt").write_text("seven")
    Path("secret.txt").write_text("not named")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--format", "json")
    result = invoke("validate", "src/zz_games/walk.py", "--contract", "gymnasium", *options)
    assert result.exit_code == 0, result.output
    [report] = json.loads(result.stdout)["reports"]
    assert {"data/level.txt", "zz_games/inner/level.txt"} & set(report["project"]["files"])
    assert "secret.txt" not in report["project"]["files"]


@pytest.fixture
def maze(tmp_path: Path) -> Path:
    """A package with a module, data and a hidden file, and a module beside it."""
    for path, text in {
        "maze/__init__.py": "from .grid import Grid\n",
        "maze/sizes.py": "import json\nfrom maze import walls\nSIZE = 4\n",
        "maze/walls.py": "",
        "maze/levels/one.txt": "1",
        "maze/.secret": "2",
        "beside.py": "",
        "unused.py": "",
    }.items():
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    (tmp_path / "maze" / "outside").symlink_to("/etc/hostname")
    return tmp_path


@pytest.mark.parametrize(
    ("path", "source", "expected"),
    [
        ("maze/grid.py", "from .sizes import SIZE\n", {"maze/__init__.py", "maze/sizes.py", "maze/walls.py"}),
        ("maze/grid.py", "import maze.walls\n", {"maze/__init__.py", "maze/walls.py"}),
        ("maze/grid.py", "from sizes import SIZE\n", {"maze/__init__.py", "maze/sizes.py", "maze/walls.py"}),
        ("game.py", "import beside\n", {"beside.py"}),
        ("game.py", "def f():\n    from . import beside\n", {"beside.py"}),
        ("game.py", "open('maze/levels/one.txt')\n", {"maze/levels/one.txt"}),
        ("maze/grid.py", "from . import walls\n'levels'", {"maze/__init__.py", "maze/walls.py", "maze/levels/one.txt"}),
        ("maze/grid.py", "'.secret', 'outside', '../beside.py', '/etc', '', '.', 'a\\0b'", set()),
        ("game.py", "import numpy, missing\n", set()),
        ("game.py", "import maze.(\n", set()),
    ],
)
def test_a_file_gets_what_it_needs_of_its_project(path: str, source: str, expected: set[str], maze: Path) -> None:
    found = _below(maze, path, source)
    # Without ``__init__.py`` a relative import makes the folder a package, and the paths start above it.
    assert {name.removeprefix(f"{maze.name}/") for name in found} == expected


def test_what_is_too_large_for_a_project_is_left_out(maze: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("envcraft.model.project._MAX_BYTES", 40)
    assert set(_below(maze, "maze/grid.py", "from . import walls\nfrom .sizes import SIZE\n")) == {
        "maze/walls.py",
        "maze/__init__.py",
    }


@pytest.mark.parametrize(
    ("module", "name", "expected"),
    [
        ("maze.grid", "Grid", "maze/grid.py"),
        ("maze", "Grid", "maze/grid.py"),
        ("maze.walls", "Grid", None),
        ("numpy", "ndarray", None),
    ],
)
def test_a_class_of_a_module_is_found_in_the_file_that_defines_it(
    module: str, name: str, expected: str | None, maze: Path
) -> None:
    (maze / "maze" / "grid.py").write_text("class Grid: ...\n")
    assert defining_file(maze, module, name) == (expected and (maze / expected, name))


def test_a_module_is_judged_with_its_project(invoke: Invoke, maze: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = "from .sizes import SIZE\nfrom maze import walls\nprint(SIZE, walls.__name__, __name__)\n"
    (maze / "maze" / "grid.py").write_text(lines + ENVIRONMENT.replace("class Walk", "class Grid"))
    monkeypatch.chdir(maze)
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--format", "json")
    result = invoke("validate", "maze:Grid", *options, "--output", "report.json")
    assert result.exit_code == 0, result.output
    [report] = json.loads(Path("report.json").read_text())["reports"]
    [finding] = report["checks"][0]["findings"]
    assert finding["message"].endswith("prints '4 maze.walls maze.grid'")
    assert report["path"] == "maze/grid.py"
    assert report["project"]["root"] == "."
    assert set(report["project"]["files"]) == {"maze/__init__.py", "maze/sizes.py", "maze/walls.py"}
    # A helper is part of what was judged.
    Path("maze/walls.py").write_text("WALLS = 1\n")
    assert "maze/grid.py has changed since the report" in invoke("replay", "report.json", "--sandbox", "process").output
    # A contract for single files leaves a file's project out, and says so.
    refused = invoke("validate", "maze/grid.py", *options[:-2])
    assert refused.exit_code == 1
    assert "a file of its project, and the contract arcade is for single files" in " ".join(refused.stdout.split())


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("walk:Wlak", "walk.py defines no class Wlak; its classes are Walk"),
        ("games.snake:Snakes", "games/snake.py defines no class Snakes; its classes are Snake"),
        ("games.snale:Snake", "the folder games has no module games.snale; games has snake"),
    ],
)
def test_a_module_of_the_working_directory_that_lacks_the_class_is_a_sentence(
    target: str, words: str, invoke: Invoke, good: Path
) -> None:
    (good.parent / "games").mkdir()
    (good.parent / "games" / "snake.py").write_text(ENVIRONMENT.replace("Walk", "Snake"))
    result = invoke("validate", target)
    assert (result.exit_code, result.stderr) == (2, f"Error: {words}\n")


@pytest.mark.parametrize(
    "line", ["Env = Walk", "Env = type('Env', (Walk,), {})", "from games.walk import *\n\nglobals()['Env'] = Walk"]
)
def test_a_class_that_a_module_of_the_working_directory_assigns_is_judged_as_its_file(
    line: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("games").mkdir()
    good.rename("games/walk.py")
    Path("games/named.py").write_text(f"from .walk import Walk\n\n{line}\n")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--format", "json")
    result = invoke("validate", "games.named:Env", "--contract", "gymnasium", *options)
    [report] = json.loads(result.stdout)["reports"]
    assert (result.exit_code, report["path"], report["env_class"]) == (0, "games/named.py", "Env")


def test_a_class_that_a_file_imports_is_judged_where_its_package_is_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("here", "there"):
        (tmp_path / folder / "games").mkdir(parents=True)
        (tmp_path / folder / "games" / "__init__.py").write_text("from compiled import Walk\n")
    monkeypatch.chdir(tmp_path / "here")
    assert [target.kind for target in resolve("games:Walk")] == [Kind.SOURCE]
    monkeypatch.syspath_prepend(tmp_path / "there")
    assert [target.kind for target in resolve("games:Walk")] == [Kind.MODULE]


def test_the_traceback_of_an_import_has_only_lines_of_files(
    invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("games").mkdir()
    Path("games/__init__.py").touch()
    Path("games/sizes.py").write_text("import math\n\nSIZE = math.size\n")
    Path("games/walk.py").write_text(f"from .sizes import SIZE\n{ENVIRONMENT}")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--format", "json")
    result = invoke("validate", "games/walk.py", "--contract", "gymnasium", *options)
    [finding] = json.loads(result.stdout)["reports"][0]["checks"][0]["findings"]
    assert finding["code"] == "EC003"
    assert re.findall(r'File "(.*?)"', finding["evidence"]["traceback"]) == ["games/walk.py", "games/sizes.py"]


def test_the_line_that_draws_is_found_in_an_installed_module(
    invoke: Invoke, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    draws = "random.randrange(1, 9)"
    assert "self.x, self.steps, self.goal = 5, 0," in ENVIRONMENT
    text = "import random\n" + ENVIRONMENT.replace("self.goal = 5, 0,", f"self.goal = {draws}, 0,")
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "zz_walk.py").write_text(text)
    monkeypatch.setattr("sys.path", [*sys.path, str(tmp_path / "there")])
    options = ("--sandbox", "process", "--contract", "gymnasium", "--budget", "quick", "--checks", "determinism")
    result = invoke("validate", "zz_walk:Walk", *options)
    line = 1 + next(number for number, words in enumerate(text.splitlines()) if draws in words)
    assert f"zz_walk.py:{line}" in result.stdout, result.output
    assert f"line {line} takes a number" in result.stdout
    assert f"{line} | self.x, self.steps" in result.stdout


def test_the_line_of_another_file_that_draws_is_named(invoke: Invoke, good: Path) -> None:
    good.write_text("import helpers\n" + ENVIRONMENT.replace("self.goal = 5, 0,", "self.goal = helpers.start(), 0,"))
    unused = "def unused():\n    return random.random()\n\n\n"
    good.with_name("helpers.py").write_text(
        f"import random\n\n\n{unused}def start():\n    return random.randrange(1, 9)\n"
    )
    options = ("--sandbox", "process", "--contract", "gymnasium", "--budget", "quick", "--checks", "determinism")
    result = invoke("validate", good, *options, "--format", "json")
    [finding] = [each for check in json.loads(result.stdout)["reports"][0]["checks"] for each in check["findings"]]
    assert finding["code"] == "EC204"
    assert "helpers.py line 9 takes a number that no seed of reset() controls: random.randrange()" in finding["message"]
    assert [line.endswith("helpers.py:9") for line in finding["evidence"]["lines"]] == [True]


def test_a_named_module_is_found_in_src(invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(good.parent)
    Path("pyproject.toml").write_text("[project]\nname = 'zz_games'\n")
    Path("src/zz_games").mkdir(parents=True)
    Path("src/zz_games/__init__.py").write_text("from .walk import Walk\n")
    good.rename("src/zz_games/walk.py")
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--format", "json")
    for target in ("zz_games.walk:Walk", "zz_games:Walk"):
        result = invoke("validate", target, *options)
        assert result.exit_code == 0, result.output
        [report] = json.loads(result.stdout)["reports"]
        assert report["path"] == "src/zz_games/walk.py"
    missing = invoke("validate", "zz_games.run:Walk", *options)
    assert (missing.exit_code, missing.stderr) == (
        2,
        "Error: the folder zz_games has no module zz_games.run; zz_games has walk\n",
    )
    # Nor does an editable installation change what is judged; a container would not have it.
    monkeypatch.syspath_prepend(good.parent / "src")
    assert [target.kind for target in resolve("zz_games.walk:Walk")] == [Kind.SOURCE]
    # What is installed below the working directory is not the project's.
    (good.parent / ".venv/lib/site-packages").mkdir(parents=True)
    Path("src/zz_games").rename(".venv/lib/site-packages/zz_games")
    monkeypatch.syspath_prepend(good.parent / ".venv/lib/site-packages")
    assert [target.kind for target in resolve("zz_games.walk:Walk")] == [Kind.MODULE]


def test_a_class_is_judged_from_the_folder_that_it_was_imported_from(
    good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder in ("zz_envs", "zz_utils"):
        (good.parent / folder).mkdir()
    (good.parent / "zz_utils/sizes.py").write_text("SIZE = 7\n")
    (good.parent / "zz_envs/line.py").write_text(f"from zz_utils.sizes import SIZE\n{ENVIRONMENT}")
    monkeypatch.syspath_prepend(good.parent)
    monkeypatch.chdir(good.parent)
    kind = importlib.import_module("zz_envs.line").Walk
    envcraft.check_env(kind(), sandbox="process")
    report = envcraft.validate(kind, contract="gymnasium", sandbox="process", budget="quick", checks=["source"])
    assert report.reports[0].verdict == "pass"


@pytest.mark.parametrize("target", ["walk.py", "walk:Walk"])
def test_a_wrapper_of_the_project_is_found(
    target: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    good.rename("walk.py")
    Path("scales.py").write_text("FACTOR = 2\n")
    Path("wrappers.py").write_text(
        "import gymnasium as gym\nfrom scales import FACTOR\n\n\n"
        "class Scale(gym.RewardWrapper):\n    def reward(self, reward):\n        return float(FACTOR * reward)\n"
    )
    options = ["--sandbox", "process", "--contract", "gymnasium", "--checks", "api", "--budget", "quick"]
    result = invoke("validate", target, "--wrap", "wrappers:Scale", *options, "--format", "json")
    assert result.exit_code == 0, result.output
    [report] = json.loads(result.stdout)["reports"]
    assert set(report["project"]["files"]) == {"wrappers.py", "scales.py"}


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("pkg/walk:Walk", "did you mean pkg.walk:Walk?"),
        ("pkg.walk", "pkg.walk is a module; name its class too: pkg.walk:CLASS"),
    ],
)
def test_a_module_that_is_written_otherwise_is_suggested(
    target: str, words: str, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(good.parent)
    Path("pkg").mkdir()
    good.rename("pkg/walk.py")
    with pytest.raises(UsageError) as raised:
        list(resolve(target))
    assert words in str(raised.value)


def test_an_installed_package_wins_over_a_folder_of_its_name(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(good.parent)
    Path("gymnasium").mkdir()
    Path("gymnasium", "own.py").write_text("")
    [target] = resolve("gymnasium.envs.classic_control:CartPoleEnv")
    assert target.kind is Kind.MODULE


@pytest.mark.parametrize("statement", ["from .helper import SIZE", "from . import helper"])
def test_a_relative_import_of_no_file_suggests_the_nearest(invoke: Invoke, good: Path, statement: str) -> None:
    (good.parent / "helpers.py").write_text("SIZE = 3\n")
    good.write_text(f"{statement}\n{ENVIRONMENT}")
    result = invoke("validate", good, "--sandbox", "process", "--contract", "gymnasium", "--format", "concise")
    assert "line 1 imports .helper, which is not a file of its package; did you mean .helpers?" in result.stdout


def test_a_message_names_files_as_the_project_does(invoke: Invoke, good: Path) -> None:
    package = good.parent / "maze"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "grid.py").write_text(f"from . import helper\n{ENVIRONMENT}")
    found = invoke("validate", package / "grid.py", "--sandbox", "process", "--contract", "gymnasium")
    assert "cannot import name 'helper' from 'maze' (maze/__init__.py)" in found.stdout


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
    ("text", "code"), [(_ASSIGNED, "EC007"), (f"{_ASSIGNED}Two = type('Two', (Env,), {{}})\n", "EC006")]
)
def test_a_class_that_is_only_assigned_is_judged_in_its_folder(
    text: str, code: str, invoke: Invoke, good: Path
) -> None:
    good.write_text(text)
    options = ("--sandbox", "process", "--budget", "quick", "--checks", "source", "--contract", "gymnasium")
    result = invoke("validate", ".", *options, "--format", "concise")
    assert f"./walk.py:{text.count(chr(10))}: {code}" in result.stdout, result.output


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


def test_an_audit_says_that_it_takes_single_files(maze: Path) -> None:
    target = Target(str(maze / "maze" / "grid.py"), b"from .sizes import SIZE\n")
    subject: Any = SimpleNamespace(left_out=None, contract=GYMNASIUM, target=target)
    words = why_unknown(".sizes", subject, [])
    assert words == "a file of its project, which only `envcraft validate` and the audit of its folder judge with it"
    assert why_unknown("nunpy", subject, ["numpy"]) == "which is not a known library; did you mean numpy?"


@pytest.mark.parametrize(
    ("file", "folder", "words"),
    [
        (
            "games/a.py",
            ".",
            "in the working directory; `envcraft validate games.a:A` finds it, and every command does if games has an "
            "__init__.py",
        ),
        (
            "src/games/old/a.py",
            "src",
            "in src; in src, `envcraft validate games.old.a:A` finds it, and every command does if src/games and "
            "src/games/old have an __init__.py",
        ),
    ],
)
def test_an_import_of_a_folder_above_names_what_finds_it(
    file: str, folder: str, words: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = good.parent / file
    place.parent.mkdir(parents=True)
    Path(good.parent, folder, "common").mkdir()
    good.rename(Path(good.parent, folder, "common", "base.py"))
    place.write_text("from common.base import Walk\n\n\nclass A(Walk):\n    pass\n")
    options = ("--sandbox", "process", "--checks", "source", "--contract", "gymnasium", "--format", "concise")
    refused = invoke("validate", file, *options)
    assert f"line 1 imports common, which is not beside the file but {words}\n" in refused.stdout
    named = re.search(r"validate (\S+)`", words)
    assert named is not None
    with monkeypatch.context() as inside:
        inside.chdir(good.parent / folder)
        assert invoke("validate", named[1], *options).exit_code == 0
    for each in re.findall(r"[\w/]*games[\w/]*(?= and| has| have)", words):
        Path(each, "__init__.py").touch()
    assert invoke("validate", file, *options).exit_code == 0


@pytest.mark.parametrize(
    ("folder", "contract", "words"),
    [
        ("src", "gymnasium", "in src; move the class to a file in src, or install it beside EnvCraft"),
        ("lib", "gymnasium", "in lib; move the class to a file in lib, or install it beside EnvCraft"),
        ("src", "arcade", "in src; move the class to a file in src"),
    ],
)
def test_a_class_of_a_test_whose_base_is_in_a_folder_on_the_path(
    folder: str, contract: str, words: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (good.parent / folder / "mazes").mkdir(parents=True)
    (good.parent / "tests").mkdir()
    good.rename(good.parent / folder / "mazes" / "base.py")
    monkeypatch.setattr("sys.path", [str(good.parent / folder), *sys.path])
    file = good.parent / "tests" / "test_local.py"
    file.write_text("from mazes.base import Walk\n\n\nclass Local(Walk):\n    pass\n")
    result = invoke("validate", file, "--sandbox", "process", "--contract", contract, "--format", "concise")
    assert f"line 1 imports mazes, which is not beside the file but {words}\n" in result.stdout


@pytest.mark.parametrize(
    ("settings", "text", "folder"),
    [
        ("pyproject.toml", "[project]\n", "src"),
        ("setup.py", "", "src"),
        ("pyproject.toml", "[tool.pytest.ini_options]\npythonpath = ['lib']\n", "lib"),
        ("pyproject.toml", "[tool.pytest]\npythonpath = 'lib'\n", "lib"),
        ("pytest.ini", "[pytest]\npythonpath = src lib\n", "lib"),
        ("setup.cfg", "[tool:pytest]\npythonpath = lib\n", "lib"),
    ],
)
def test_a_base_is_found_where_the_settings_or_the_layout_say(
    settings: str, text: str, folder: str, invoke: Invoke, good: Path, tmp_path: Path
) -> None:
    (tmp_path / folder / "mazes").mkdir(parents=True)
    (tmp_path / "tests").mkdir()
    (tmp_path / settings).write_text(text)
    (tmp_path / folder / "mazes" / "__init__.py").write_text("from .base import Walk\n")
    (tmp_path / "tests" / "helper.py").write_text("")
    broken = ENVIRONMENT.replace("self.steps += 1", "self.steps += 1 // (self.steps < 3)")
    (tmp_path / folder / "mazes" / "base.py").write_text(broken)
    file = tmp_path / "tests" / "local.py"
    file.write_text("import helper\nfrom mazes import Walk\n\n\nclass Local(Walk):\n    pass\n")
    options = ("--sandbox", "process", "--contract", "gymnasium", "--checks", "api", "--budget", "quick")
    result = invoke("validate", "tests", *options, "--format", "json", "--output", "report.json")
    assert result.exit_code == 1, result.output
    [report] = json.loads(Path("report.json").read_text())["reports"]
    files = {"tests/helper.py", f"{folder}/mazes/__init__.py", f"{folder}/mazes/base.py"}
    assert (report["project"]["root"], set(report["project"]["files"])) == (".", files)
    assert report["project"]["imports"] == ["tests", folder]
    [finding] = report["checks"][1]["findings"]
    assert (finding["code"], finding["line"]) == ("EC107", 5)
    assert "step() is inherited from mazes.base.Walk (base.py:" in finding["message"]
    assert "#1 EC107 tests/local.py:5: reproduced" in invoke("replay", "report.json", "--sandbox", "process").output


def test_only_folders_of_the_project_are_imported_from(tmp_path: Path) -> None:
    project = tmp_path / "project"
    for folder in (tmp_path / "beside", project / "src", project / "deep" / "tests"):
        folder.mkdir(parents=True)
    settings = project / "pyproject.toml"
    settings.write_text("[tool.pytest.ini_options]\npythonpath = ['../beside', '/', '.', 'none']\n")
    (project / "src" / "__init__.py").touch()
    assert import_folders(project / "deep" / "tests") == (project,)
    settings.write_text("pythonpath")
    assert import_folders(project / "deep") == ()
    assert import_folders(tmp_path) == ()


@pytest.mark.parametrize(
    ("registers", "words"),
    [
        ('register(id="Walk-v0", entry_point="regpkg.walk:Walk")', "name its class, regpkg.walk:Walk"),
        ('register("Walk-v0", entry_point="regpkg.walk:Walk")', "name its class, regpkg.walk:Walk"),
        ("register(**TABLE)", "name its class, such as regpkg.module:Class"),
    ],
)
def test_an_id_of_a_package_that_is_not_installed_names_its_class(
    registers: str, words: str, invoke: Invoke, tmp_path: Path
) -> None:
    (tmp_path / "regpkg").mkdir()
    (tmp_path / "regpkg" / "__init__.py").write_text(f"from gymnasium import register\n{registers}\n")
    (tmp_path / "regpkg" / "walk.py").write_text(ENVIRONMENT)
    result = invoke("validate", "regpkg:Walk-v0", "--sandbox", "process")
    assert result.exit_code == 2
    assert "an id of the package regpkg, which is not installed" in result.stderr
    assert words in result.stderr


@pytest.mark.parametrize("layout", [".", "src"])
@pytest.mark.parametrize("name", ["regpkg/Walk-v0", "RegPkg/Walk-v0", "regpkg:regpkg/Walk-v0"])
def test_an_id_of_the_project_names_its_class(
    name: str, layout: str, invoke: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / layout / "regpkg"
    package.mkdir(parents=True)
    (tmp_path / "pyproject.toml").touch()
    wanted = name.rpartition(":")[2]
    (package / "__init__.py").write_text(f'register(id="{wanted}", entry_point="regpkg.walk:Walk")\n')
    monkeypatch.chdir(tmp_path)
    result = invoke("validate", name, "--sandbox", "process", "--budget", "quick")
    assert result.exit_code == 2
    assert f"{name} is an id of the package regpkg" in result.stderr
    assert result.stderr.endswith("name its class, regpkg.walk:Walk\n")


@pytest.mark.parametrize(
    ("text", "advice"),
    [
        ('register("Walk-v0", entry_point=Walk)', "regfile:Walk"),
        ('register("Walk-v0", Walk, max_episode_steps=9)', "regfile:Walk"),
        ('register(id="Walk-v0", entry_point="regfile:Walk", reward_threshold=9)', "regfile:Walk"),
        ("register(ID, entry_point=Walk)", "such as regfile:Class"),
    ],
)
def test_an_id_that_a_file_registers_names_its_class(
    text: str, advice: str, invoke: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tmp_path.joinpath("regfile.py").write_text(f"{text}\n")
    monkeypatch.chdir(tmp_path)
    result = invoke("validate", "regfile:Walk-v0", "--sandbox", "process", "--budget", "quick")
    assert (result.exit_code, result.stderr.endswith(f"; name its class, {advice}\n")) == (2, True)
