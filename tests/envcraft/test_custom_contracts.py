"""Contracts in pyproject.toml: the example of the documentation, and a sentence for every mistake."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from envcraft.contracts.builtin import ARCADE, GYMNASIUM
from envcraft.contracts.custom import custom_contracts, valid_contract
from envcraft.errors import UsageError
from envcraft.model.contract import Contract
from envcraft.spaces.spec import read_space

BUILT_IN = [ARCADE, GYMNASIUM]
QUICK = ("--sandbox", "process", "--budget", "quick", "--checks", "api,reward,termination")


def example(root: Path) -> str:
    found = re.findall(r"```toml\n(.*?)```", (root / "docs" / "contracts.md").read_text("utf-8"), re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def write(folder: Path, text: str) -> Path:
    (folder / "pyproject.toml").write_text(text)
    return folder


def test_the_documentation_s_example(root: Path, tmp_path: Path) -> None:
    text = example(root)
    assert len(text.splitlines()) <= 20
    (maze,) = custom_contracts(write(tmp_path, text), BUILT_IN)
    assert (maze.name, maze.limit, maze.noop, maze.reward_range) == ("maze", 200, 4, (-1.0, 10.0))
    assert (maze.success.key, maze.success.sign) == ("solved", False)
    assert maze.without == ("EC503",)
    view = {"type": "Box", "low": 0, "high": 255, "shape": [64, 64, 3], "dtype": "uint8"}
    given = {"type": "Dict", "spaces": [["keys", {"type": "MultiBinary", "shape": [3]}], ["view", view]]}
    assert maze.observation is not None
    assert read_space(maze.observation) == read_space(given)
    assert read_space(maze.observation) != read_space({"type": "Dict", "spaces": [["view", view]]})


def test_what_is_not_said_is_as_in_the_base(tmp_path: Path) -> None:
    text = '[tool.envcraft.contracts.long]\nbase = "arcade"\nlimit = 5000\n'
    (contract,) = custom_contracts(write(tmp_path, text), BUILT_IN)
    assert (contract.observation, contract.noop, contract.render) == (ARCADE.observation, ARCADE.noop, True)
    assert contract.limit == 5000


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("limits = 3", "there is no setting 'limits'; did you mean limit?"),
        ("reward_rang = 3", "there is no setting 'reward-rang'; did you mean reward-range?"),
        ('limit = "long"', "limit must be a whole number, not 'long'"),
        ('libraries = ["numpy", 3]', r"libraries\[1\] must be text, not 3"),
        ("limit = 0", "limit is 0; it must be 1 or more"),
        ('base = "arcde"', "the base 'arcde' is not a contract; choose from arcade, gymnasium"),
        ("reward-range = [1, 0]", "reward-range: 1 is above 0"),
        ("reward-range = [1]", r"reward-range must be a list of length 2, not \[1\]"),
        ("action = 3", "action must be a table, not 3"),
        ('action = { type = "Buttons" }', "action: there is no space 'Buttons'; choose from Box, Discrete"),
        ('action = { type = "Discrete" }', "action: n is missing"),
        ('action = { type = "Discrete", n = 2, stat = 1 }', "action: there is no setting 'stat'; did you mean start?"),
        (
            'action = { type = "MultiDiscrete", nvec = "x" }',
            r"action\.nvec must be a whole number or a list",
        ),
        ('action = { type = "Discrete", n = 0 }', r"action\.n is 0"),
        ('action = { type = "Discrete", n = 2 }\nnoop = 2', r"noop: the action is 2, outside Discrete\(2\)$"),
        ("noop = 0", "noop needs action"),
        ('observation = { type = "Box", shape = [2], low = 1, high = 0 }', "observation: low is above high"),
        ('observation = { type = "Box", shape = [2], low = [1, 2, 3] }', "observation.low does not fit the shape"),
        (
            'observation = { type = "Box", shape = [2], dtype = "float31" }',
            "dtype .float31. is not a type of numbers",
        ),
        (
            'observation = { type = "Dict", spaces = { a = { type = "Text" } } }',
            r"observation\.spaces\.a: .*max_length",
        ),
        ('without = ["505"]', "'505' is not a code such as EC505"),
        ('without = ["EC503", "EC999"]', "without: there is no rule 'EC999'"),
        ("consistently = 2.0", "consistently is 2"),
        ('render = "sometimes"', "render is 'sometimes'; it must be required, optional or off"),
        ("render = 3", "render must be true or false or text, not 3"),
    ],
)
def test_every_mistake_is_named(lines: str, words: str, tmp_path: Path, invoke: Any) -> None:
    write(tmp_path, f"[tool.envcraft.contracts.mine]\n{lines}\n")
    with pytest.raises(UsageError, match=words):
        custom_contracts(tmp_path, BUILT_IN, lambda: ["EC503", "EC505"])
    result = invoke("contracts")
    assert result.exit_code == 2
    assert "pyproject.toml: [tool.envcraft.contracts.mine]" in result.stderr


@pytest.mark.parametrize(
    ("written", "read"),
    [('"required"', True), ("true", True), ('"optional"', "optional"), ('"off"', False), ("false", False)],
)
def test_render_is_required_optional_or_off(tmp_path: Path, written: str, read: bool | str) -> None:
    write(tmp_path, f"[tool.envcraft.contracts.mine]\nbase = 'arcade'\nrender = {written}\n")
    (contract,) = custom_contracts(tmp_path, BUILT_IN)
    assert contract.render == read


def test_names_are_not_taken_twice(tmp_path: Path) -> None:
    write(tmp_path, "[tool.envcraft.contracts.arcade]\nlimit = 3\n")
    with pytest.raises(UsageError, match="the name arcade is taken"):
        custom_contracts(tmp_path, BUILT_IN)


def test_listed_and_judged_by(tmp_path: Path, invoke: Any, good: Path) -> None:
    """The walk of the tests ends by step 100, and pays 1."""
    text = '[tool.envcraft]\nbudget = "quick"\n[tool.envcraft.contracts.{}]\nbase = "arcade"\n{}\n'
    write(tmp_path, text.format("short", "limit = 50\nsummary = 'at most 50 steps'"))
    assert "at most 50 steps" in invoke("contracts").stdout
    result = invoke("validate", good, *QUICK, "--contract", "short", "--format", "json")
    assert result.exit_code == 1
    (report,) = json.loads(result.stdout)["reports"]
    assert [f["code"] for check in report["checks"] for f in check["findings"]] == ["EC501"]
    write(tmp_path, text.format("mean", "reward-range = [-1, 0.5]\nwithout = ['EC303']"))
    assert invoke("validate", good, *QUICK, "--contract", "mean").exit_code == 0
    write(tmp_path, text.format("mean", "reward-range = [-1, 0.5]"))
    assert "outside -1 to 0.5" in invoke("validate", good, *QUICK, "--contract", "mean").stdout


def test_toml_reads_infinities(tmp_path: Path) -> None:
    line = 'observation = { type = "Box", low = -inf, high = inf, shape = [2] }'
    assert tomllib.loads(line)["observation"]["high"] == float("inf")
    (contract,) = custom_contracts(write(tmp_path, f"[tool.envcraft.contracts.free]\n{line}\n"), BUILT_IN)
    given = {"type": "Box", "low": "-inf", "high": "inf", "shape": [2], "dtype": "float32"}
    assert contract.observation is not None
    assert read_space(contract.observation) == read_space(given)


def test_a_plugin_s_contract_has_the_defaults_of_a_table() -> None:
    contract = valid_contract(Contract(name="six", summary="", action={"type": "Discrete", "n": 6}, noop=0))
    assert contract.action is not None
    assert str(read_space(contract.action)) == "Discrete(6)"
    with pytest.raises(UsageError, match="the contract six of a plugin is not valid: action: n is missing"):
        valid_contract(Contract(name="six", summary="", action={"type": "Discrete"}))
    with pytest.raises(UsageError, match="the contract six of a plugin is not valid: noop: "):
        valid_contract(Contract(name="six", summary="", action={"type": "Discrete", "n": 6}, noop=6))
