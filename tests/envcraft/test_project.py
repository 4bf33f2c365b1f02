"""What a file is judged with: the modules and the data of its project, and the folders that it imports from."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from envcraft_checks.libraries import why_unknown

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.model.classes import defining_file
from envcraft.model.import_folders import import_folders
from envcraft.model.project import with_project
from envcraft.model.target import Target
from tests.envcraft.conftest import ENVIRONMENT, Invoke


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


def test_an_audit_says_that_it_takes_single_files(maze: Path) -> None:
    target = Target(str(maze / "maze" / "grid.py"), b"from .sizes import SIZE\n")
    subject: Any = SimpleNamespace(left_out=None, contract=GYMNASIUM, target=target)
    words = why_unknown(".sizes", subject, [])
    assert words == "a file of its project, which only `envcraft validate` and the audit of its folder judge with it"
    assert why_unknown("nunpy", subject, ["numpy"]) == "which is not a known library; did you mean numpy?"


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


def test_a_message_names_files_as_the_project_does(invoke: Invoke, good: Path) -> None:
    package = good.parent / "maze"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "grid.py").write_text(f"from . import helper\n{ENVIRONMENT}")
    found = invoke("validate", package / "grid.py", "--sandbox", "process", "--contract", "gymnasium")
    assert "cannot import name 'helper' from 'maze' (maze/__init__.py)" in found.stdout


@pytest.mark.parametrize("statement", ["from .helper import SIZE", "from . import helper"])
def test_a_relative_import_of_no_file_suggests_the_nearest(invoke: Invoke, good: Path, statement: str) -> None:
    (good.parent / "helpers.py").write_text("SIZE = 3\n")
    good.write_text(f"{statement}\n{ENVIRONMENT}")
    result = invoke("validate", good, "--sandbox", "process", "--contract", "gymnasium", "--format", "concise")
    assert "line 1 imports .helper, which is not a file of its package; did you mean .helpers?" in result.stdout


@pytest.mark.parametrize("statement", ["from pkg.wrld import World", "import pkg.wrld"])
def test_an_import_of_no_module_of_the_package_suggests_the_nearest(invoke: Invoke, good: Path, statement: str) -> None:
    package = good.parent / "pkg"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "world.py").write_text("World = 3\n")
    (package / "game.py").write_text(f"{statement}\n{ENVIRONMENT}")
    options = ("--sandbox", "process", "--contract", "gymnasium", "--format", "concise")
    result = invoke("validate", package / "game.py", *options)
    assert "No module named 'pkg.wrld'; did you mean pkg.world?" in result.stdout


def test_an_import_of_no_file_suggests_the_one_beside(invoke: Invoke, good: Path) -> None:
    (good.parent / "helper.py").write_text("SIZE = 3\n")
    good.write_text(f"from helpr import SIZE\n{ENVIRONMENT}")
    result = invoke("validate", good, "--sandbox", "process", "--contract", "gymnasium", "--format", "concise")
    assert "line 1 imports helpr, which is not a known library; did you mean helper?" in result.stdout


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
