"""``envcraft new``: its files pass under any valid name, and no file is overwritten."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from envcraft.cli.commands.new import names
from envcraft.errors import UsageError

CONTRACTS = ("arcade", "arcade-native", "gymnasium")
#: Checks that say nothing about a contract's environments.
SKIPPED = {"gymnasium": {"instadeath"}}


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=300, check=False)


def test_the_tutorial_shows_what_it_writes(invoke: Any, tmp_path: Path) -> None:
    invoke("new", "Lantern")
    lines = (tmp_path / "lantern.py").read_text().splitlines()
    tutorial = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text("utf-8")
    removed = next(line[1:] for line in tutorial.splitlines() if line.startswith("-        self.you"))
    number = 1 + lines.index(removed)
    assert set(re.findall(r"lantern\.py:(\d+)", tutorial)) == {str(number)}
    assert f"      {number} | {removed.strip().replace('self.np_random.integers', 'np.random.randint')}\n" in tutorial
    about = re.search(r"a game of (\d+) lines", tutorial)
    assert about is not None
    assert abs(len(lines) - int(about[1])) < 10


def test_the_page_on_properties_tests_what_it_writes(invoke: Any, tmp_path: Path) -> None:
    invoke("new", "Lantern")
    page = (Path(__file__).parents[2] / "docs" / "testing.md").read_text("utf-8")
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    few = "import hypothesis\nhypothesis.settings.register_profile('few', max_examples=20, database=None)\n"
    (tmp_path / "conftest.py").write_text(few)
    (tmp_path / "test_properties.py").write_text("\n".join(blocks))
    options = ("--hypothesis-profile=few", "--hypothesis-seed=0", "-p", "no:cacheprovider", "test_properties.py")
    done = run(tmp_path, "pytest", "-q", *options)
    assert "2 passed" in done.stdout, done.stdout


@pytest.mark.parametrize("contract", CONTRACTS)
def test_what_it_writes_passes_and_its_test_is_green(invoke: Any, tmp_path: Path, contract: str) -> None:
    result = invoke("new", "FruitCatch", "--contract", contract, "--folder", "games")
    assert result.exit_code == 0, result.stderr
    option = "" if contract == "arcade" else f" --contract {contract}"
    assert result.stdout.splitlines() == [
        "wrote games/fruit_catch.py",
        "wrote games/test_fruit_catch.py",
        "",
        "Edit it, then run",
        f"  envcraft validate games/fruit_catch.py{option}",
        "  pytest games/test_fruit_catch.py",
    ]
    assert "class FruitCatch(gym.Env" in (tmp_path / "games" / "fruit_catch.py").read_text()

    quick = ("--budget", "quick", "--sandbox", "process")
    options = ("--contract", contract, *quick, "--format", "json", "--output", "report.json")
    judged = run(tmp_path, "envcraft", "validate", "games/fruit_catch.py", *options)
    assert judged.returncode == 0, judged.stderr
    [subject] = json.loads((tmp_path / "report.json").read_text())["reports"]
    assert (subject["verdict"], subject["env_class"]) == ("pass", "FruitCatch")
    assert not [finding for check in subject["checks"] for finding in check["findings"]]
    skipped = {check["check"] for check in subject["checks"] if check["verdict"] == "skip"}
    assert skipped == SKIPPED.get(contract, set())

    brief = ("--envcraft-sandbox", "process", "--envcraft-budget", "quick", "--envcraft-checks", "api")
    tested = run(tmp_path, "pytest", "games/test_fruit_catch.py", *brief)
    assert tested.returncode == 0, tested.stdout
    assert "passed" in tested.stdout


@pytest.mark.parametrize("contract", CONTRACTS)
def test_the_templates_are_short(root: Path, contract: str) -> None:
    assert len((root / "envcraft" / "templates" / contract / "new_game.py").read_text().splitlines()) < 120


def test_nothing_is_overwritten(invoke: Any, tmp_path: Path) -> None:
    (tmp_path / "test_lantern.py").write_text("mine")
    result = invoke("new", "Lantern")
    assert result.exit_code == 2
    assert result.stderr == ("Error: test_lantern.py exists; nothing was written. Choose another name or a --folder\n")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("test_lantern.py", "mine")]


def test_a_folder_that_is_none_is_a_sentence(invoke: Any, tmp_path: Path) -> None:
    (tmp_path / "games").write_text("")
    result = invoke("new", "Lantern", "--folder", "games")
    assert (result.exit_code, result.stderr) == (2, "Error: games is a file; name a folder\n")


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Lantern", ("lantern", "Lantern")),
        ("lantern", ("lantern", "Lantern")),
        ("fruit_catch", ("fruit_catch", "FruitCatch")),
        ("FruitCatch", ("fruit_catch", "FruitCatch")),
        ("fruitCatch2", ("fruit_catch2", "FruitCatch2")),
        ("RPGMaze", ("rpg_maze", "RPGMaze")),
    ],
)
def test_names(name: str, expected: tuple[str, str]) -> None:
    assert names(name) == expected


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("fruit-catch", "fruit_catch"),
        ("Fruit Catch!", "fruit_catch"),
        ("2048", "game_2048"),
        ("class", "game_class"),
        ("Break", "game_break"),
        ("none", "game_none"),
        ("???", "game"),
        ("_Lantern", "lantern"),
        ("random", "random_game"),
        ("numpy", "numpy_game"),
        ("test_it", "it_game"),
        ("../lantern", "lantern --folder .."),
        ("fruit_catch.py", "fruit_catch"),
        ("games/sky/Lantern", "lantern --folder games/sky"),
    ],
)
def test_invalid_name_is_reported_with_a_valid_one(name: str, near: str) -> None:
    with pytest.raises(UsageError, match=f"try `envcraft new {near}`"):
        names(name)
    names(near.partition(" ")[0])


def test_a_name_that_the_template_needs(invoke: Any, tmp_path: Path) -> None:
    result = invoke("new", "Any")
    assert result.exit_code == 2
    assert "try `envcraft new AnyGame`" in result.stderr
    assert not list(tmp_path.iterdir())


def test_new_with_custom_contract_names_a_template(invoke: Any, tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text(
        '[tool.envcraft]\ncontract = "maze"\nbudget = "quick"\n\n'
        '[tool.envcraft.contracts.maze]\nsummary = "mazes"\naction = { type = "Discrete", n = 5 }\n'
    )
    result = invoke("new", "Lantern")
    assert result.exit_code == 2
    assert "the contract maze has no template; start with --contract gymnasium" in result.stderr
    assert invoke("new", "Lantern", "--contract", "gymnasium").exit_code == 0
