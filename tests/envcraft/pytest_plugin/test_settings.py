"""Where settings come from."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.envcraft.pytest_plugin.stand_in import Canned, Run

pytest_plugins = ["pytester"]


def test_settings_come_from_the_strongest_source(
    pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned
) -> None:
    pytester.makepyprojecttoml(
        """
        [tool.envcraft]
        contract = "gymnasium"
        seed = 5
        time-limit = 90
        skip = ["reward"]
        [tool.pytest.ini_options]
        envcraft_seed = 6
        envcraft_time_limit = 45
        envcraft_checks = ["api", "reward"]
        """
    )
    run("games")
    plan = canned.plans[-1]
    assert (plan.contract.name, plan.seed, plan.budget.name, plan.time_limit) == ("gymnasium", 6, "quick", 45)
    assert [check.name for check in plan.checks] == ["source", "api", "sandbox"]
    options = ["--envcraft-seed=7", "--envcraft-contract=arcade-native", "--envcraft-checks=observation,reward"]
    run("games", *options, "--envcraft-time-limit=30.5")
    plan = canned.plans[-1]
    assert (plan.contract.name, plan.seed, plan.time_limit) == ("arcade-native", 7, 30.5)
    assert [check.name for check in plan.checks] == ["source", "observation", "sandbox"]


def test_ini_files_take_lists_with_commas(pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned) -> None:
    pytester.makeini("[pytest]\nenvcraft_checks = api, reward\nenvcraft_skip = reward\nenvcraft_contract = gymnasium\n")
    run("games")
    assert [check.name for check in canned.plans[-1].checks] == ["source", "api", "sandbox"]
    assert canned.plans[-1].contract.name == "gymnasium"


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("--envcraft-checks=determinsm", "*there is no check 'determinsm'; did you mean determinism[?]"),
        ("--envcraft-contract=arcad", "*there is no contract 'arcad'; did you mean arcade[?]"),
        ("--envcraft-budget=quik", "*there is no budget 'quik'; did you mean quick[?]"),
        ("--envcraft-sandbox=doker", "*there is no sandbox 'doker'; did you mean docker[?]"),
        ("--envcraft-seed=-1", "*the seed '-1' is not a whole number from 0 to 2147483647"),
        ("--envcraft-time-limit=0", "*the time limit '0' is not a number of seconds above 0"),
        ("--envcraft-checks=", "*--envcraft-checks '' leaves no check to run; *"),
        ("--envcraft-contract=", "*there is no contract ''*"),
        ("--envcraft-time-limit=soon", "*the time limit 'soon' is not a number of seconds above 0"),
    ],
)
def test_wrong_settings_are_a_sentence(walk: Path, run: Run, option: str, sentence: str) -> None:
    result = run("games", option)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([sentence])
    assert "Traceback" not in result.stderr.str()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('contract = "arcad"', "contract: there is no contract 'arcad'; did you mean arcade?"),
        ('budget = "quik"', "budget: there is no budget 'quik'; did you mean quick?"),
        ('sandbox = "doker"', "sandbox: there is no sandbox 'doker'; did you mean docker?"),
        ("seed = -1", "seed: the seed -1 is not a whole number"),
        ("checks = []", "checks '' leaves no check to run"),
        ("time-limit = true", "time-limit: the time limit True is not a number of seconds above 0"),
        ("time-limit = 0", "time-limit: the time limit 0 is not a number of seconds above 0"),
        ('skip = ["reword"]', "skip: there is no check 'reword'; did you mean reward?"),
    ],
)
def test_a_setting_is_blamed_on_its_file(pytester: pytest.Pytester, walk: Path, setting: str, words: str) -> None:
    file = pytester.makepyprojecttoml(f"[tool.envcraft]\n{setting}\n")
    result = pytester.runpytest_inprocess("--envcraft", "games")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert f"{file}: [tool.envcraft] {words}" in result.stderr.str()


def test_an_option_is_not_blamed_on_the_file(pytester: pytest.Pytester, walk: Path, run: Run) -> None:
    pytester.makepyprojecttoml('[tool.envcraft]\ncontract = "gymnasium"\n')
    result = run("games", "--envcraft-contract=arcad")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "pyproject" not in result.stderr.str()


def test_a_setting_of_a_command_is_ignored(pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned) -> None:
    pytester.makepyprojecttoml('[tool.envcraft]\nexecutor = "local"\nseed = 3\n')
    run("games")
    assert canned.plans[-1].seed == 3
