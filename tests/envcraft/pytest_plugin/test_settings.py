"""Where settings come from."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.envcraft.pytest_plugin.stand_in import QUICK, Canned, Run, outcomes

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
        (
            "--envcraft-checks=determinsm",
            "--envcraft-checks: there is no check 'determinsm'; did you mean determinism[?]",
        ),
        ("--envcraft-contract=arcad", "--envcraft-contract: there is no contract 'arcad'; did you mean arcade[?]"),
        ("--envcraft-budget=quik", "--envcraft-budget: there is no budget 'quik'; did you mean quick[?]"),
        ("--envcraft-sandbox=doker", "--envcraft-sandbox: there is no sandbox 'doker'; did you mean docker[?]"),
        ("--envcraft-seed=-1", "--envcraft-seed: the seed '-1' is not a whole number from 0 to 2147483647"),
        ("--envcraft-time-limit=0", "--envcraft-time-limit: the time limit '0' is not a number of seconds above 0"),
        ("--envcraft-checks=", "--envcraft-checks '' leaves no check to run; *"),
        ("--envcraft-contract=", "--envcraft-contract: there is no contract ''*"),
        (
            "--envcraft-time-limit=soon",
            "--envcraft-time-limit: the time limit 'soon' is not a number of seconds above 0",
        ),
    ],
)
def test_wrong_settings_are_a_sentence(walk: Path, run: Run, option: str, sentence: str) -> None:
    result = run("games", option)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([f"ERROR: {sentence}"])
    assert "Traceback" not in result.stderr.str()


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('envcraft_contract = "gym"', "envcraft_contract: there is no contract 'gym'; did you mean gymnasium?"),
        ('envcraft_seed = "x"', "envcraft_seed: the seed 'x' is not a whole number from 0 to 2147483647"),
        (
            'envcraft_checks = ["EC203"]',
            'envcraft_checks: EC203 is a code, and envcraft_checks takes checks; name select = "EC203" in [tool',
        ),
        ('envcraft_time_limit = "0"', "envcraft_time_limit: the time limit '0' is not a number of seconds above 0"),
    ],
)
def test_a_setting_of_pytest_is_blamed_on_its_file(
    pytester: pytest.Pytester, walk: Path, run: Run, setting: str, words: str
) -> None:
    file = pytester.makepyprojecttoml(f"[tool.pytest.ini_options]\n{setting}\n")
    result = run("games")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert f"ERROR: {file}: {words}" in result.stderr.str()
    given = run(
        "games",
        "-o",
        "envcraft_contract=arcad",
        "-o",
        "envcraft_seed=0",
        "-o",
        "envcraft_time_limit=1",
        "-o",
        "envcraft_checks=api",
    )
    given.stderr.fnmatch_lines(["ERROR: -o envcraft_contract: there is no contract 'arcad'; did you mean arcade[?]"])


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ('contract = "arcad"', "contract: there is no contract 'arcad'; did you mean arcade?"),
        ('budget = "quik"', "budget: 'quik' is not one of 'quick', 'standard', 'thorough'."),
        ('sandbox = "doker"', "sandbox: there is no sandbox 'doker'; did you mean docker?"),
        ("seed = -1", "seed: -1 is not a whole number from 0 to 2147483647"),
        ("checks = []", "checks: '' leaves no check to run"),
        ("time-limit = true", "time-limit: 'true' is not a number above 0"),
        ("time-limit = 0", "time-limit: 0.0 is not a number above 0"),
        ('skip = ["reword"]', "skip: there is no check 'reword'; did you mean reward?"),
        ("select = []", "select: '' names no code"),
        ('ignore = "EC901"', "ignore: EC901 cannot be ignored"),
        (
            'baseline = "none.json"',
            "baseline: the baseline none.json does not exist; "
            "`envcraft validate TARGET --baseline '' --format json --output none.json` makes it",
        ),
        ('policy = "none.py"', "policy: the policy none.py cannot be read: No such file or directory"),
        ('kwargs = "[1]"', "kwargs: [1] is not a JSON object"),
        ("strict = 3", "strict: 3 is neither true nor false"),
        (
            'sandbox = "process"\nrequire-isolation = "container"',
            "require-isolation: the process sandbox isolates by process only",
        ),
        ('checks = ["api"]\nskip = ["api"]', "checks: 'api' and skip 'api' leave no check to run"),
    ],
)
def test_a_setting_is_blamed_on_its_file(pytester: pytest.Pytester, walk: Path, setting: str, words: str) -> None:
    file = pytester.makepyprojecttoml(f"[tool.envcraft]\n{setting}\n")
    result = pytester.runpytest_inprocess("--envcraft", "games")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert f"{file}: [tool.envcraft] {words}" in result.stderr.str()


def test_an_option_that_contradicts_the_file_names_both(pytester: pytest.Pytester, walk: Path, run: Run) -> None:
    file = pytester.makepyprojecttoml('[tool.envcraft]\nskip = ["api"]\n')
    result = run("games", "--envcraft-checks=api")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    words = f"ERROR: --envcraft-checks 'api' and {file}: [tool.envcraft] skip 'api' leave no check to run"
    assert words in result.stderr.str()


def test_an_option_is_not_blamed_on_the_file(pytester: pytest.Pytester, walk: Path, run: Run) -> None:
    pytester.makepyprojecttoml('[tool.envcraft]\ncontract = "gymnasium"\n')
    result = run("games", "--envcraft-contract=arcad")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert "pyproject" not in result.stderr.str()


@pytest.mark.parametrize(
    ("setting", "checks"),
    [
        ('select = "EC2"\nskip = "reward"', ["source", "determinism", "sandbox"]),
        ('checks = ["reward", "observation"]\nignore = ["EC3"]', ["source", "observation", "sandbox"]),
    ],
)
def test_selected_and_ignored_rules_are_those_of_the_command(
    pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned, setting: str, checks: list[str]
) -> None:
    pytester.makepyprojecttoml(f"[tool.envcraft]\n{setting}\n")
    tests = outcomes(run("games", "-v"))
    assert [test.partition("::")[2] for test in tests] == checks
    assert [check.name for check in canned.plans[-1].checks] == checks


def test_excluded_files_are_not_collected(pytester: pytest.Pytester, walk: Path, run: Run) -> None:
    walk.with_name("old_walk.py").write_text(walk.read_text())
    pytester.makepyprojecttoml('[tool.envcraft]\nexclude = ["old_*"]\nchecks = ["source"]\n')
    assert {test.partition("::")[0] for test in outcomes(run(".", "-v"))} == {"games/walk.py"}
    assert {test.partition("::")[0] for test in outcomes(run("games/old_walk.py", "-v"))} == {"games/old_walk.py"}
    walk.unlink()
    run(".").stdout.fnmatch_lines(["envcraft: exclude in [[]tool.envcraft] leaves none of 1 environment"])


def test_settings_say_how_to_judge(pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned) -> None:
    pytester.makepyprojecttoml(
        """
        [tool.envcraft]
        strict = true
        fail-fast = true
        policy = "win.py"
        baseline = "base.json"
        kwargs = {render_mode = "rgb_array"}
        wrap = ["gymnasium.wrappers:FlattenObservation"]
        format = "json"
        """
    )
    pytester.path.joinpath("base.json").write_text('{"reports": []}')
    pytester.path.joinpath("win.py").write_text("class Policy:\n    def act(self, env, seed):\n        return 0\n")
    run("games")
    plan = canned.plans[-1]
    assert (plan.severity.strict, plan.fail_fast, plan.policy and plan.policy.path) == (True, True, "win.py")
    assert canned.target.kwargs == {"render_mode": "rgb_array"}
    assert canned.target.wrappers == ("gymnasium.wrappers:FlattenObservation",)


def test_what_the_command_ignores_passes_here_too(pytester: pytest.Pytester, walk: Path) -> None:
    walk.write_text(walk.read_text().replace("float(won), won", "float('nan'), won"))
    assert pytester.runpytest_inprocess(*QUICK, "--envcraft-checks=reward", "games").ret == 1
    pytester.makepyprojecttoml('[tool.envcraft]\nignore = "EC301"\n')
    result = pytester.runpytest_inprocess(*QUICK, "--envcraft-checks=reward", "games")
    assert result.ret == 0, result.stdout.str()


def test_strict_fails_what_is_undecided(pytester: pytest.Pytester, walk: Path) -> None:
    walk.write_text(walk.read_text().replace("won = self.x >= self.goal", "won = False"))
    options = (*QUICK, "--envcraft-checks=difficulty", "games")
    assert pytester.runpytest_inprocess(*options).parseoutcomes()["skipped"]
    pytester.makepyprojecttoml("[tool.envcraft]\nstrict = true\n")
    result = pytester.runpytest_inprocess(*options)
    assert result.parseoutcomes()["failed"] == 1, result.stdout.str()


def test_a_setting_of_a_command_is_ignored(pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned) -> None:
    pytester.makepyprojecttoml('[tool.envcraft]\nexecutor = "local"\nseed = 3\n')
    run("games")
    assert canned.plans[-1].seed == 3


@pytest.mark.parametrize(
    ("option", "meant"), [("--envcraft-budgt", "budget"), ("--envcraft-contrat=arcade", "contract")]
)
def test_a_misspelt_option_has_a_suggestion(option: str, meant: str, run: Run, canned: Canned) -> None:
    result = run(option)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    name = option.partition("=")[0]
    result.stderr.fnmatch_lines(f"ERROR: there is no option '{name}'; did you mean --envcraft-{meant}[?] All other*")


def test_an_option_of_a_conftest_may_have_the_same_prefix(pytester: pytest.Pytester, run: Run) -> None:
    pytester.makeconftest("def pytest_addoption(parser):\n    parser.addoption('--envcraft-levels')\n")
    pytester.makepyfile("def test(pytestconfig):\n    assert pytestconfig.getoption('envcraft_levels') == '3'\n")
    run("--envcraft-levels", "3").assert_outcomes(passed=1)
