"""Validation from Python reads ``[tool.envcraft]`` as the command does, and has its options as keyword arguments."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import pytest

import envcraft
from envcraft.cli.commands.validate import validate as command
from tests.envcraft.conftest import ENVIRONMENT

_CHEAP: dict[str, Any] = {"sandbox": "process", "budget": "quick"}
_BROKEN = ENVIRONMENT.replace("float(won), won", "float('nan'), won")


@pytest.fixture(autouse=True)
def project(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.chdir(tmp_path)
    tmp_path.joinpath("walk.py").write_text(_BROKEN)
    return tmp_path


def settings(project: Path, text: str) -> None:
    project.joinpath("pyproject.toml").write_text(f"[tool.envcraft]\n{text}\n")


def checks(report: Any) -> list[str]:
    return [check.check for check in report.reports[0].checks]


def test_settings_apply(project: Path) -> None:
    settings(project, 'sandbox = "process"\ncontract = "gymnasium"\nbudget = "quick"\nchecks = "reward"\nseed = 3')
    report = envcraft.validate("walk.py")
    assert (report.contract, report.budget, report.seed) == ("gymnasium", "quick", 3)
    assert (report.reports[0].driver, checks(report)) == ("process", ["source", "reward", "sandbox"])
    settings(project, 'sandbox = "process"\nbudget = "quick"\nignore = ["EC301"]\nchecks = "reward"\nstrict = true')
    report = envcraft.validate("walk.py")
    assert (report.reports[0].outcome, report.strict) == ("pass", True)


def test_arguments_win_over_settings(project: Path) -> None:
    settings(project, 'contract = "gymnasium"\nbudget = "thorough"\nskip = "reward"\nignore = "EC3"\nstrict = true')
    given: dict[str, Any] = {"contract": "arcade", "checks": ["reward"], "skip": (), "ignore": (), "strict": False}
    report = envcraft.validate("walk.py", **_CHEAP, **given)
    assert (report.contract, report.budget, report.strict) == ("arcade", "quick", False)
    assert report.reports[0].outcome == "fail"


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('contract = "gym"', "contract: there is no contract 'gym'; did you mean gymnasium?"),
        ('budget = "huge"', "budget: 'huge' is not one of 'quick', 'standard', 'thorough'."),
        ('checks = "EC203"', "checks: EC203 is a code"),
        ("kwargs = {sise = 3}", "kwargs: "),
        ('wrap = "TimeLimit"', "wrap: the wrapper 'TimeLimit' must be 'module:func'"),
        ('bugdet = "quick"', "has no setting 'bugdet'; did you mean budget?"),
    ],
)
def test_a_setting_is_blamed_on_its_file(project: Path, setting: str, words: str) -> None:
    settings(project, f'sandbox = "process"\n{setting}')
    with pytest.raises(envcraft.UsageError) as caught:
        envcraft.validate("walk.py")
    assert str(caught.value).startswith(f"{project / 'pyproject.toml'}: [tool.envcraft] {words}")


def test_rules_are_selected_and_ignored(project: Path) -> None:
    assert checks(envcraft.validate("walk.py", **_CHEAP, select=["EC301"])) == ["source", "reward", "sandbox"]
    report = envcraft.validate("walk.py", **_CHEAP, checks="reward", ignore="EC301, EC5")
    assert report.reports[0].outcome == "pass"


def test_files_are_excluded_and_a_baseline_is_known(project: Path) -> None:
    project.joinpath("old_walk.py").write_text(_BROKEN)
    report = envcraft.validate(".", **_CHEAP, checks="reward", exclude="old_*")
    assert [one.path for one in report.reports] == ["./walk.py"]
    with pytest.raises(envcraft.UsageError, match=r"^exclude leaves none of 2 environments"):
        envcraft.validate(".", **_CHEAP, exclude=["*"])
    with pytest.raises(envcraft.UsageError) as caught:
        envcraft.validate("walk.py", **_CHEAP, baseline="none.json")
    advice = "`envcraft validate TARGET --baseline '' --format json --output none.json` makes it"
    assert str(caught.value) == f"the baseline none.json does not exist; {advice}"
    settings(project, 'baseline = "none.json"')
    with pytest.raises(envcraft.UsageError) as caught:
        envcraft.validate("walk.py", **_CHEAP)
    assert str(caught.value).endswith(f"baseline: the baseline none.json does not exist; {advice}")


def test_several_targets_are_judged_each_once(project: Path) -> None:
    project.joinpath("other.py").write_text(ENVIRONMENT)
    report = envcraft.validate(["other.py", Path("walk.py"), "other.py"], **_CHEAP, checks="reward")
    assert [(one.path, one.outcome) for one in report.reports] == [("other.py", "pass"), ("walk.py", "fail")]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"checks": "EC203"}, "EC203 is a code, and checks takes checks; name select=EC203"),
        ({"select": "reward"}, "reward is a check, and select takes codes; name checks=reward"),
        ({"checks": []}, "checks='' leaves no check to run"),
        ({"env_class": "Cart"}, "env_class=Cart does not apply to CartPole-v1"),
        ({"sandbox": "process", "runtime": "runsc"}, "runtime runsc requires the docker sandbox"),
    ],
)
def test_an_error_names_keyword_arguments(options: dict[str, Any], words: str) -> None:
    with pytest.raises(envcraft.UsageError) as caught:
        envcraft.validate("CartPole-v1", contract="gymnasium", **options)
    assert words in str(caught.value)
    assert "--" not in str(caught.value)


def test_check_env_applies_the_settings_that_say_what_counts(project: Path) -> None:
    settings(project, 'contract = "arcade"\nsandbox = "process"\nkwargs = {size = 3}\nchecks = ["reward"]')
    with pytest.raises(envcraft.CheckFailed, match="EC301"):
        envcraft.check_env("walk.py")
    settings(project, 'sandbox = "process"\nignore = "EC301"\nchecks = ["reward"]')
    envcraft.check_env("walk.py")
    still = "won = self.x >= self.goal", "won = False"
    project.joinpath("walk.py").write_text(ENVIRONMENT.replace(*still))
    settings(project, 'sandbox = "process"\nchecks = ["difficulty"]')
    envcraft.check_env("walk.py", warn=False, contract="arcade")
    settings(project, 'sandbox = "process"\nchecks = ["difficulty"]\nstrict = true')
    with pytest.raises(envcraft.CheckFailed, match="difficulty is undecided"):
        envcraft.check_env("walk.py", contract="arcade")


def test_every_option_that_says_how_to_judge_has_a_keyword() -> None:
    """docs/using.md lists the options without one."""
    names = {"wrap": "wrappers"}
    options = {names.get(str(each.name), str(each.name)) for each in command.params}
    without = options - set(inspect.signature(envcraft.validate).parameters) - {"targets"}
    assert without == {"form", "output", "also", "environments_only", "exit_zero", "quiet", "verbose"}
