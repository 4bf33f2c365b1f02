"""The pytest plugin, driven by pytest itself: what is collected, how each verdict shows, and how often code is run.

Tests of the mapping from verdicts to outcomes replace the engine by one with given reports; the others run it.
"""

from __future__ import annotations

import importlib
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

import envcraft.engine
from envcraft.check import Check
from envcraft.cli import offered
from envcraft.commands.choices import all_checks
from envcraft.engine import Plan
from envcraft.errors import SandboxUnavailable
from envcraft.events import Finished
from envcraft.pytest_plugin.collection import defines_tests, environment_line
from envcraft.sandbox import Availability, Driver, Isolation, Limits, Worker
from envcraft.target import Target
from envcraft.verdict import CheckReport, Finding, Report, Repro, Severity, SubjectReport, Verdict, overall

pytest_plugins = ["pytester"]

QUICK = ("--envcraft", "--envcraft-sandbox=process", "--envcraft-budget=quick", "-p", "no:cacheprovider")
#: Would end the whole run where something imported it.
TRAP = "import sys\nsys.exit('imported')\nimport gymnasium\nclass Trap(gymnasium.Env):\n    pass\n"
HEAVY = ("numpy", "gymnasium", "msgspec", "click", "rich", "envcraft.engine", "envcraft.pytest_plugin.judging")


class Canned:
    """In place of the engine: the reports that are given for each check, else a pass; and what it was asked."""

    def __init__(self) -> None:
        self.plans: list[Plan] = []
        self.reports: dict[str, CheckReport] = {}

    def set(self, check: str, verdict: Verdict, *findings: Finding, reason: str = "") -> None:
        self.reports[check] = CheckReport(check, verdict, 1.25, list(findings), reason)

    def validate(self, plan: Plan, workers: int | None = None) -> Iterator[Finished]:
        self.plans.append(plan)
        [target] = plan.targets
        checks = [self.reports.get(check.name, CheckReport(check.name, Verdict.PASS)) for check in plan.checks]
        report = SubjectReport(
            target.path, "Walk", target.sha256, overall(checks), "process", 1.0, 42, checks, plan.driver.name
        )
        yield Finished(Report(plan.contract.name, plan.seed, [report]))

    @property
    def target(self) -> Target:
        return self.plans[-1].targets[0]


class NoDriver(Driver):
    """Is asked for nothing."""

    name, isolation = "process", Isolation.PROCESS

    def probe(self) -> Availability:
        raise AssertionError

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        raise AssertionError


def failing(code: str, message: str, line: int | None = None) -> Finding:
    return Finding(code, Severity.ERROR, message, line, repro=Repro(7, [[0, 0, 0]] * 41, {"hash_seed": 1}))


@pytest.fixture(scope="module", autouse=True)
def loaded() -> None:
    """What pytest imports in a run within this process it forgets after it: this is kept."""
    for hook in ("envcraft_checks", "envcraft_contracts", "envcraft_reporters", "envcraft_sandbox_drivers"):
        offered(hook)
    importlib.import_module("envcraft.commands.validate")
    importlib.import_module("envcraft.pytest_plugin.fixture")


@pytest.fixture(autouse=True)
def without_hypothesis(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its plugin imports all of it at the end of each run, which takes longer than the run."""
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:hypothesispytest")


@pytest.fixture(autouse=True)
def at_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where these are set, pytest repeats each failure whole in its summary."""
    monkeypatch.delenv("CI", raising=False)
    monkeypatch.delenv("BUILD_NUMBER", raising=False)


@pytest.fixture
def canned(monkeypatch: pytest.MonkeyPatch) -> Canned:
    replacement = Canned()
    monkeypatch.setattr(envcraft.engine, "validate", replacement.validate)
    monkeypatch.setattr("envcraft.pytest_plugin.judging.driver_named", lambda *_: NoDriver())
    return replacement


@pytest.fixture
def walk(good: Path, pytester: pytest.Pytester) -> Path:
    """A good environment at games/walk.py."""
    path = pytester.mkdir("games") / "walk.py"
    path.write_text(good.read_text())
    return path


Run = Callable[..., pytest.RunResult]


@pytest.fixture
def run(pytester: pytest.Pytester) -> Run:
    """pytest in this process, with the plugin as it is installed."""
    return lambda *arguments: pytester.runpytest_inprocess(*QUICK, *arguments)


def outcomes(result: pytest.RunResult) -> dict[str, str]:
    """The outcome of each test that ``-v`` told."""
    words = [line.split() for line in result.outlines if "::" in line and "%]" in line]
    return {word[0]: word[1] for word in words}


# Without --envcraft


def test_loading_the_plugin_imports_nothing_but_itself() -> None:
    code = (
        "import sys, pytest\nbefore = set(sys.modules)\nimport envcraft.pytest_plugin\n"
        "print(sorted(set(sys.modules) - before))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "['envcraft', 'envcraft.pytest_plugin']"


@pytest.mark.parametrize("flag", [(), ("--envcraft", "--collect-only")])
def test_a_run_that_judges_nothing_loads_nothing(pytester: pytest.Pytester, walk: Path, flag: tuple[str, ...]) -> None:
    pytester.makepyfile(test_own="def test_own(): pass")
    heavy = HEAVY if not flag else ("numpy", "gymnasium", "envcraft.engine")
    pytester.makeconftest(
        f"import sys\ndef pytest_unconfigure(): print('loaded', [n for n in {heavy!r} if n in sys.modules])"
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", *flag)
    result.stdout.fnmatch_lines(["loaded []"])
    if not flag:
        result.assert_outcomes(passed=1)
        assert "envcraft:" not in result.stdout.str()
        assert "games" not in result.stdout.str()


def test_the_plugin_can_be_left_out(pytester: pytest.Pytester, walk: Path) -> None:
    result = pytester.runpytest_inprocess("-p", "no:envcraft", "--envcraft")
    result.stderr.fnmatch_lines(["*unrecognized arguments: --envcraft*"])


# Collection


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ("import gymnasium as gym\n\nclass Snake(gym.Env):\n    pass\n", 3),
        ("from gymnasium import Env\nclass Snake(Env[int, int]): pass\n", 2),
        ("def f():\n    import gymnasium\nclass A: pass\nclass B(MiniGridEnv): pass\n", 4),
        ("import gymnasium\nclass A:\n    def reset(self): ...\n    def step(self): ...\n", 2),
        ("import gym\nclass A(gym.Env)\n    pass\n", 1),
        ("import gymnasium\nclass A(gymnasium.Env):\n    x = " + "(" * 5_000, 1),
        ("import gymnasium\nclass A(gymnasium.Wrapper):\n    def reset(self): ...\n    def step(self): ...\n", None),
        ("import gymnasium\nclass A: pass\ndef make(): ...\n", None),
        ("'about gymnasium'\nclass Snake(Env): pass\n", None),
        ("from .gymnasium import Env\nclass Snake(Env): pass\n", None),
        ("class Snake(Env)  # no Python, nor about it\n", None),
    ],
)
def test_what_is_an_environment_is_told_by_the_source(tmp_path: Path, source: str, line: int | None) -> None:
    path = tmp_path / "a.py"
    path.write_text(source)
    assert environment_line(path) == line


def test_the_sources_of_others_raise_no_warning_here(tmp_path: Path, recwarn: pytest.WarningsRecorder) -> None:
    path = tmp_path / "a.py"
    path.write_text("import gymnasium\nclass A(gymnasium.Env):\n    x = '\\d'\n")
    assert environment_line(path) == 2
    assert not defines_tests(path)
    assert not recwarn.list


def test_one_item_a_check_and_nothing_imported(pytester: pytest.Pytester, run: Run) -> None:
    games = pytester.mkdir("games")
    for name in ("__init__", "trap", "check_trap", "also/trap"):
        (games / name).with_suffix(".py").parent.mkdir(exist_ok=True)
        (games / name).with_suffix(".py").write_text(TRAP)
    (games / "helper.py").write_text("import gymnasium\nimport sys\nsys.exit(1)\n")
    (games / "test_own.py").write_text("import gymnasium\nclass OwnEnv(gymnasium.Env): pass\ndef test_own(): pass\n")
    (games / "conftest.py").write_text("import gymnasium\nclass OwnEnv(gymnasium.Env): pass\n")
    (games / "__init__.py").write_text("")
    result = run("--collect-only", "-q", "games", "--envcraft-checks=api")
    files = ("games/also/trap.py", "games/check_trap.py", "games/trap.py")
    expected = [f"{file}::{check}" for file in files for check in ("source", "api", "sandbox")]
    assert sorted(line for line in result.outlines if "::" in line) == sorted(
        [*expected, "games/test_own.py::test_own"]
    )
    assert result.ret == 0


@pytest.mark.parametrize("how", [("games/trap.py",), ("games", "--doctest-modules"), ("games/trap.py::reward",)])
def test_nothing_else_imports_an_environment_file(
    pytester: pytest.Pytester, run: Run, canned: Canned, how: tuple[str, ...]
) -> None:
    games = pytester.mkdir("games")
    (games / "trap.py").write_text(TRAP + '    """\n    >>> 1\n    1\n    """\n')
    # Whoever sets up the folder as a package imports this.
    (games / "__init__.py").write_text("raise SystemExit('imported')" if "--doctest-modules" not in how else "")
    result = run("-v", *how)
    assert result.ret == 0
    assert set(outcomes(result)) >= {"games/trap.py::reward"}
    assert set(outcomes(result).values()) == {"PASSED"}
    assert len(canned.plans) == 1


def test_a_named_file_without_environment_is_judged_unless_it_has_tests(
    pytester: pytest.Pytester, run: Run, canned: Canned
) -> None:
    pytester.makepyfile(odd="import sys\nsys.exit('imported')\n", own="def test_own(): pass\n")
    result = run("-v", "odd.py", "own.py", "--envcraft-checks=api")
    assert list(outcomes(result)) == ["odd.py::source", "odd.py::api", "odd.py::sandbox", "own.py::test_own"]


def test_python_files_stay_with_pytest_unless_they_are_all(
    pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned
) -> None:
    (walk.parent / "check_own.py").write_text(
        "import gymnasium\nclass OwnEnv(gymnasium.Env): pass\ndef test_a(): ...\n"
    )
    result = run("-v", "-o", "python_files=check_*.py *.py", "--envcraft-checks=api", "games")
    assert set(outcomes(result)) == {
        "games/check_own.py::test_a",
        *(f"games/walk.py::{check}" for check in ("source", "api", "sandbox")),
    }


def test_selection_runs_only_what_is_wanted_in_one_run(walk: Path, run: Run, canned: Canned) -> None:
    assert list(outcomes(run("-v", "games", "-k", "reward or observation"))) == [
        "games/walk.py::reward",
        "games/walk.py::observation",
    ]
    assert [check.name for check in canned.plans[-1].checks] == ["source", "reward", "observation", "sandbox"]
    assert list(outcomes(run("-v", "games/walk.py::api"))) == ["games/walk.py::api"]
    assert [check.name for check in canned.plans[-1].checks] == ["source", "api", "sandbox"]
    run("games", "-m", "not envcraft")
    assert len(canned.plans) == 2


def test_first_failure_ends_the_run_and_last_failed_runs_it_again(
    pytester: pytest.Pytester, walk: Path, canned: Canned
) -> None:
    canned.set("determinism", Verdict.FAIL, failing("EC203", "differs"))
    result = pytester.runpytest_inprocess("--envcraft", "-x", "-v", "games")
    assert list(outcomes(result).values()) == ["PASSED", "PASSED", "FAILED"]
    result = pytester.runpytest_inprocess("--envcraft", "--lf", "-v", "games")
    assert outcomes(result) == {"games/walk.py::determinism": "FAILED"}
    assert len(canned.plans) == 2


# Verdicts


def test_real_runs_and_the_commands_that_they_print(
    pytester: pytest.Pytester, walk: Path, bad: Path, run: Run, root: Path
) -> None:
    (walk.parent / "bad.py").write_text(bad.read_text())
    nan = walk.read_text().replace("float(won), won", "float('nan'), won")
    (walk.parent / "nan.py").write_text(nan)
    result = run("-v", "games", "--envcraft-checks=api,reward", "--junit-xml=junit.xml")
    assert outcomes(result) == {
        "games/bad.py::source": "FAILED",
        "games/bad.py::api": "SKIPPED",
        "games/bad.py::reward": "SKIPPED",
        "games/bad.py::sandbox": "PASSED",
        "games/nan.py::source": "PASSED",
        "games/nan.py::api": "PASSED",
        "games/nan.py::reward": "FAILED",
        "games/nan.py::sandbox": "PASSED",
        "games/walk.py::source": "PASSED",
        "games/walk.py::api": "PASSED",
        "games/walk.py::reward": "PASSED",
        "games/walk.py::sandbox": "PASSED",
    }
    result.stdout.fnmatch_lines(
        [
            "*reward of games/nan.py*",
            "EC301 not-finite games/nan.py:*",
            "  the reward of step 1 is nan*",
            "  fix: *",
            "  reproduction: seed *, 1 action",
            "",
            "To see it again:",
            "  envcraft validate games/nan.py *--budget quick --seed 0 --sandbox process --format json *",
            "  envcraft replay report.json --finding 1",
            "envcraft: 3 environments judged, process isolation; *",
        ]
    )
    assert "pytest_plugin" not in result.stdout.str()
    # Typed as printed, the commands show it again.
    printed = [shlex.split(line) for line in result.outlines if line.startswith("  envcraft ")]
    statuses = [subprocess.run([sys.executable, "-m", *words], capture_output=True).returncode for words in printed]
    assert [words[1] for words in printed] == ["validate", "replay", "validate", "replay"]
    assert statuses == [1, 0, 1, 0]

    cases = {
        (case.get("classname"), case.get("name")): case for case in ElementTree.parse("junit.xml").iter("testcase")
    }
    case = cases["games.nan", "reward"]
    properties = {found.get("name"): found.get("value", "") for found in case.iter("property")}
    assert int(properties.pop("envcraft_steps")) > 10
    assert len(properties.pop("envcraft_source_sha256")) == 64
    assert properties == {
        "envcraft_subject": "games/nan.py",
        "envcraft_class": "Walk",
        "envcraft_contract": "arcade",
        "envcraft_budget": "quick",
        "envcraft_seed": "0",
        "envcraft_isolation": "process",
        "envcraft_driver": "process",
        "envcraft_codes": "EC301",
    }
    failure = case.find("failure")
    assert failure is not None
    assert "EC301 not-finite games/nan.py" in str(failure.get("message"))


def test_skip_carries_the_reason_and_the_place(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("difficulty", Verdict.SKIP, reason="the search\nsettled nothing")
    result = run("games", "-rs", "--durations=1", "--durations-min=0.1")
    result.assert_outcomes(passed=9, skipped=1)
    result.stdout.fnmatch_lines(
        ["1.25s setup * games/walk.py::difficulty", "SKIPPED * games/walk.py:8: the search settled nothing"]
    )


def test_what_could_not_judge_is_an_error(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("reward", Verdict.ERROR, reason="the worker stopped answering; try again")
    result = run("games", "--junit-xml=junit.xml")
    result.assert_outcomes(passed=9, errors=1)
    result.stdout.fnmatch_lines(
        [
            "the check reward could not judge games/walk.py, which says nothing against it: the worker stopped *",
            "Try it by itself: envcraft validate games/walk.py --contract arcade --budget quick *",
        ]
    )
    tags = [case.find("error") is not None for case in ElementTree.parse("junit.xml").iter("testcase")]
    assert tags.count(True) == 1


def test_no_sandbox_is_an_error_with_the_next_step(
    walk: Path, run: Run, canned: Canned, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def unavailable(name: str, *_: Any) -> None:
        asked.append(name)
        raise SandboxUnavailable("the sandbox docker does not work here; start the Docker engine")

    monkeypatch.setattr("envcraft.pytest_plugin.judging.driver_named", unavailable)
    result = run("games", "--envcraft-checks=api")
    result.assert_outcomes(errors=3)
    assert result.ret == 1
    result.stdout.fnmatch_lines(["nothing was judged: the sandbox docker does not work here; start the Docker engine"])
    assert asked == ["process"]


def test_a_check_that_breaks_is_an_error(walk: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Check, subject: object) -> None:
        raise ValueError("out of cheese")

    [reward] = [check for check in all_checks() if check.name == "reward"]
    monkeypatch.setattr(type(reward), "judge", broken)
    result = run("games/walk.py::reward")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*the check broke: ValueError: out of cheese"])


def test_warnings_are_shown_and_fail_nothing_unless_a_filter_wants_it(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("determinism", Verdict.PASS, Finding("EC209", Severity.WARNING, "all seeds give one level", 12))
    result = run("games")
    result.assert_outcomes(passed=10, warnings=1)
    result.stdout.fnmatch_lines(
        ["games/walk.py::determinism", "*games/walk.py:12: EnvCraftWarning: EC209 * one level (fix: *)"]
    )
    result = run("games", "-W", "error::envcraft.pytest_plugin.EnvCraftWarning")
    result.assert_outcomes(passed=9, failed=1)
    assert "Traceback" not in result.stdout.str()


def test_filters_of_the_tests_do_not_reach_the_judging(walk: Path, run: Run) -> None:
    walk.write_text(walk.read_text() + "\nPATTERN = '\\d'\n")
    result = run("games/walk.py::api", "-W", "error")
    result.assert_outcomes(passed=1)


def test_checks_that_verdicts_rest_on_show_in_those_selected(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("source", Verdict.FAIL, failing("EC003", "importing raises"))
    for check in ("api", "reward"):
        canned.set(check, Verdict.SKIP, reason="the file did not get past the check source")
    canned.set("sandbox", Verdict.FAIL, failing("EC905", "the network was asked for"))
    result = run("-v", "games", "-k", "api or reward")
    assert set(outcomes(result).values()) == {"FAILED"}
    result.stdout.fnmatch_lines(["*api of games*", "EC003 *", "*reward of games*", "EC905 *", "  * --finding 2"])
    canned.set("source", Verdict.PASS)
    canned.set("sandbox", Verdict.ERROR, reason="lost")
    result = run("-v", "games/walk.py::api")
    assert outcomes(result) == {"games/walk.py::api": "ERROR"}


def test_control_characters_of_an_environment_are_not_printed(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("api", Verdict.FAIL, failing("EC107", "step() raises \x1b[2Jgone\u202e"))
    result = run("games/walk.py::api", "--junit-xml=junit.xml")
    assert "\x1b" not in result.stdout.str()
    assert "\u202e" not in result.stdout.str()
    result.stdout.fnmatch_lines(["*step() raises \N{REPLACEMENT CHARACTER}[[]2Jgone\N{REPLACEMENT CHARACTER}"])


# Settings


def test_settings_come_from_the_strongest_source(
    pytester: pytest.Pytester, walk: Path, run: Run, canned: Canned
) -> None:
    pytester.makepyprojecttoml(
        """
        [tool.envcraft]
        contract = "gymnasium"
        seed = 5
        skip = ["reward"]
        [tool.pytest.ini_options]
        envcraft_seed = 6
        envcraft_checks = ["api", "reward"]
        """
    )
    run("games")
    plan = canned.plans[-1]
    assert (plan.contract.name, plan.seed, plan.budget.name) == ("gymnasium", 6, "quick")
    assert [check.name for check in plan.checks] == ["source", "api", "sandbox"]
    run("games", "--envcraft-seed=7", "--envcraft-contract=arcade-native", "--envcraft-checks=observation,reward")
    plan = canned.plans[-1]
    assert (plan.contract.name, plan.seed) == ("arcade-native", 7)
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
        ("--envcraft-seed=-1", "*the seed '-1' is no whole number from 0 to 2147483647"),
    ],
)
def test_wrong_settings_are_a_sentence(walk: Path, run: Run, option: str, sentence: str) -> None:
    result = run("games", option)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([sentence])
    assert "Traceback" not in result.stderr.str()


# Marker and fixture


def test_the_marker_makes_one_test_a_check(pytester: pytest.Pytester, walk: Path, canned: Canned) -> None:
    canned.set("api", Verdict.FAIL, failing("EC107", "step() raises"))
    canned.set("reward", Verdict.SKIP, reason="no reward was seen")
    pytester.makepyfile(
        test_it="""
        import pytest
        @pytest.mark.envcraft("games/walk.py", checks=["api", "reward"], sandbox="process")
        def test_body(tmp_path):
            print("ran")
            assert 0, "body"
        @pytest.mark.envcraft(target="games/walk.py", checks="api, reward")
        class TestWalk:
            @pytest.mark.envcraft(sandbox="process")
            def test_report(self, envcraft):
                assert envcraft.report.verdict == "pass"
            def test_other(self): pass
        """
    )
    result = pytester.runpytest_inprocess("-v", "-rs")
    assert outcomes(result) == {
        "test_it.py::test_body[source]": "FAILED",
        "test_it.py::test_body[api]": "FAILED",
        "test_it.py::test_body[reward]": "SKIPPED",
        "test_it.py::test_body[sandbox]": "FAILED",
        "test_it.py::TestWalk::test_report[source]": "PASSED",
        "test_it.py::TestWalk::test_report[api]": "FAILED",
        "test_it.py::TestWalk::test_report[reward]": "SKIPPED",
        "test_it.py::TestWalk::test_report[sandbox]": "PASSED",
        "test_it.py::TestWalk::test_other": "PASSED",
    }
    assert result.outlines.count("ran") == 2
    assert len(canned.plans) == 1
    result.stdout.fnmatch_lines(["EC107 *", "SKIPPED * test_it.py:*: no reward was seen"])
    assert "pytest_plugin" not in result.stdout.str()


@pytest.mark.parametrize(
    ("marker", "sentence"),
    [
        ("'games/walk.py', cheks='api'", "*marker envcraft of test_it has no cheks; it takes target, contract, *"),
        ("'a', 'b'", "*marker envcraft of test_it takes one target*"),
        ("3", "*marker envcraft of test_it cannot be followed: 3 is no target: *"),
        ("'games/walk.py', checks='apu'", "*marker envcraft of test_it cannot be followed: there is no check 'apu'; *"),
    ],
)
def test_a_wrong_marker_is_a_sentence(pytester: pytest.Pytester, walk: Path, marker: str, sentence: str) -> None:
    pytester.makepyfile(f"import pytest\n@pytest.mark.envcraft({marker})\ndef test_it(): pass")
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines([sentence])
    assert "pytest_plugin" not in result.stdout.str()


def test_classes_are_judged_from_their_file(pytester: pytest.Pytester, walk: Path, canned: Canned) -> None:
    pytester.makepyfile(
        test_it="""
        import importlib.util, sys
        import pytest
        spec = importlib.util.spec_from_file_location("walk", "games/walk.py")
        walk = sys.modules["walk"] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(walk)
        @pytest.mark.envcraft(target=walk.Walk, contract="gymnasium", checks="api", sandbox="process")
        def test_it(): pass
        def test_local(envcraft):
            class Local: pass
            envcraft.judge(Local)
        def test_built_in(envcraft):
            envcraft.judge(int)
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, errors=2)
    assert canned.target.env_class == "Walk"
    assert canned.target.path == "games/walk.py"
    assert canned.target.source == walk.read_bytes()
    result.stdout.fnmatch_lines(
        ["*Local is defined within a function or class; *", "*builtins.int is defined in no file *"]
    )


def test_the_fixture_judges_and_asserts(
    pytester: pytest.Pytester, walk: Path, canned: Canned, monkeypatch: pytest.MonkeyPatch
) -> None:
    canned.set("api", Verdict.FAIL, failing("EC107", "step() raises", 9))
    canned.set("reward", Verdict.ERROR, reason="lost")
    pytester.makepyfile(
        test_it="""
        import pytest
        QUICK = {"sandbox": "process", "budget": "quick"}
        def test_judge(envcraft, monkeypatch):
            monkeypatch.chdir("games")
            report = envcraft.judge("games/walk.py", checks=["api"], **QUICK)
            assert (report.verdict, report.path, envcraft.report) == ("fail", "games/walk.py", None)
        def test_check(envcraft):
            envcraft.check("games/walk.py", checks="api", **QUICK)
        def test_passes(envcraft):
            assert envcraft.check("games/walk.py", checks="observation", seed=3, **QUICK).steps == 42
        def test_error(envcraft):
            envcraft.check("games/walk.py", checks="reward", **QUICK)
        def test_nowhere(envcraft):
            envcraft.check("games/nowhere.py")
        def test_nothing(envcraft):
            envcraft.check()
        def test_many(envcraft):
            envcraft.check("games")
        def test_wrong(envcraft):
            with pytest.raises(TypeError, match="no option 'cheks'"):
                envcraft.check("games/walk.py", cheks="api")
        @pytest.mark.envcraft(seed=4, **QUICK)
        def test_defaults(envcraft):
            envcraft.judge("games/walk.py", checks="observation")
        """
    )
    (walk.parent / "also.py").write_text(walk.read_text())
    result = pytester.runpytest_inprocess("-v", "-p", "no:cacheprovider")
    found = {name.partition("::")[2]: outcome for name, outcome in outcomes(result).items()}
    assert found == {
        "test_judge": "PASSED",
        "test_check": "FAILED",
        "test_passes": "PASSED",
        "test_error": "ERROR",
        "test_nowhere": "ERROR",
        "test_nothing": "ERROR",
        "test_many": "ERROR",
        "test_wrong": "PASSED",
        "test_defaults": "PASSED",
    }
    result.stdout.fnmatch_lines_random(
        [
            "EC107 * games/walk.py:9",
            "  envcraft validate games/walk.py --checks source,api,sandbox *",
            "the check reward could not judge games/walk.py, *: lost",
            "nothing was judged: games/nowhere.py does not exist; *",
            "nothing was judged: there is no target: *",
            "nothing was judged: */games holds 2 environments, *",
        ]
    )
    # What was asked for twice ran once.
    assert [plan.seed for plan in canned.plans] == [0, 3, 0, 4]


# xdist

#: Counts, across processes, how often an environment is run.
COUNTING = """
import envcraft.engine
judge = envcraft.engine.validate
def counted(plan, workers):
    with open("runs.txt", "a") as runs:
        runs.write(plan.targets[0].path + "\\n")
    return judge(plan, workers)
envcraft.engine.validate = counted
"""


@pytest.mark.parametrize(
    "options",
    [
        ("-p", "no:xdist"),
        ("-n0",),
        ("-n2", "--dist", "load"),
        ("-n2", "--dist", "loadfile"),
        ("-n2", "--dist", "loadgroup"),
    ],
    ids=" ".join,
)
def test_one_run_an_environment_also_under_xdist(
    pytester: pytest.Pytester, walk: Path, monkeypatch: pytest.MonkeyPatch, options: tuple[str, ...]
) -> None:
    if "no:xdist" not in options:
        pytest.importorskip("xdist")
    monkeypatch.setenv("TMPDIR", str(pytester.mkdir("tmp")))
    pytester.makeconftest(COUNTING)
    (walk.parent / "bad.py").write_text("import gymnasium\nclass Bad(gymnasium.Env): pass\nraise ValueError\n")
    result = pytester.runpytest_subprocess(*QUICK, *options, "games", "--envcraft-checks=instadeath")
    result.assert_outcomes(passed=4, failed=1, skipped=1)
    assert sorted((pytester.path / "runs.txt").read_text().split()) == ["games/bad.py", "games/walk.py"]
    result.stdout.fnmatch_lines(["EC003 * games/bad.py:3", "envcraft: 2 environments judged, *"])
    assert not list((pytester.path / "tmp").glob("envcraft-????????"))
