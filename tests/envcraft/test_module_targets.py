"""Targets that name a module and its class, or an id: which file is judged, and what a wrong name suggests."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import pytest

import envcraft
from envcraft.environments.targets import resolve
from envcraft.errors import UsageError
from envcraft.model.target import Kind
from tests.envcraft.conftest import ENVIRONMENT, Invoke


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


def test_a_named_module_is_found_in_src_from_a_folder_beside_it(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = good.parent
    (project / "pyproject.toml").touch()
    (project / "src" / "zz_beside").mkdir(parents=True)
    (project / "src" / "zz_beside" / "sizes.py").write_text("SIZE = 7\n")
    (project / "src" / "zz_beside" / "walk.py").write_text(f"from .sizes import SIZE\n{ENVIRONMENT}")
    (project / "notebooks").mkdir()
    monkeypatch.chdir(project / "notebooks")
    assert [target.path for target in resolve(f"{good.stem}:Walk")] == ["../walk.py"]
    [target] = resolve("zz_beside.walk:Walk")
    assert target.path == "../src/zz_beside/walk.py"
    assert target.project is not None
    assert "zz_beside/sizes.py" in target.project.files


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


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("pkg/walk:Walk", "did you mean pkg.walk:Walk?"),
        ("pkg.walk", "pkg.walk is a module; name its class too: pkg.walk:Walk"),
        (
            "gymnasium.envs.toy_text",
            "gymnasium.envs.toy_text is a module; name its class too: gymnasium.envs.toy_text:",
        ),
        ("zz_pkg.walk.py", "zz_pkg.walk.py does not exist; give a Python file"),
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


def test_a_module_below_src_is_suggested_with_its_class(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (good.parent / "src" / "pkg").mkdir(parents=True)
    (good.parent / "pyproject.toml").touch()
    good.rename(good.parent / "src" / "pkg" / "walk.py")
    for folder in (good.parent, good.parent / "src" / "pkg"):
        monkeypatch.chdir(folder)
        with pytest.raises(UsageError, match=r"pkg.walk is a module; name its class too: pkg.walk:Walk"):
            resolve("pkg.walk")


@pytest.mark.parametrize(("folder", "file"), [("top", "src/pkg/walk.py"), ("top/src/pkg", "walk.py")])
@pytest.mark.parametrize(("target", "option"), [("pkg.walk:Walk", " --class Walk"), ("pkg.walk", "")])
def test_a_module_that_cannot_be_imported_here_is_named_by_its_file(
    folder: str, file: str, target: str, option: str, invoke: Invoke, good: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (good.parent / "top" / "src" / "pkg").mkdir(parents=True)
    good.rename(good.parent / "top" / "src" / "pkg" / "walk.py")
    monkeypatch.chdir(good.parent / folder)
    result = invoke("validate", target)
    words = f"pkg.walk cannot be imported from this folder; name its file: {file}{option}"
    assert (result.exit_code, result.stderr) == (2, f"Error: {words}\n")
    assert len(resolve(file, option.removeprefix(" --class ") or None)) == 1


def test_an_installed_package_wins_over_a_folder_of_its_name(good: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(good.parent)
    Path("gymnasium").mkdir()
    Path("gymnasium", "own.py").write_text("")
    [target] = resolve("gymnasium.envs.classic_control:CartPoleEnv")
    assert target.kind is Kind.MODULE


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


def test_an_id_of_an_editable_installation_is_judged_in_its_project(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    project, installed = tmp_path / "project", tmp_path / "site-packages"
    (project / "regpkg").mkdir(parents=True)
    (project / "regpkg" / "__init__.py").write_text('register("Walk-v0", entry_point="regpkg.walk:Walk")\n')
    installed.mkdir()
    monkeypatch.chdir(project)
    monkeypatch.syspath_prepend(project)
    monkeypatch.setattr("site.getsitepackages", lambda: [str(installed)])
    with pytest.raises(UsageError, match="which is not installed"):
        resolve("regpkg:Walk-v0")
    (installed / "__editable__.regpkg.pth").write_text(f"import os\n{project}\n")
    assert [target.kind for target in resolve("regpkg:Walk-v0")] == [Kind.ID]


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
