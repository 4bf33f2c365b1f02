"""How each verdict shows."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from envcraft.errors import SandboxUnavailable
from envcraft.judging.check import Check
from envcraft.judging.selection import all_checks, default_checks
from envcraft.judging.severity import SeverityPolicy
from envcraft.model.verdict import Finding, Severity, Verdict
from tests.envcraft.pytest_plugin.stand_in import Canned, Run, failing, outcomes

pytest_plugins = ["pytester"]
#: Each is a test of an environment.
CHECKS = len(default_checks())


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
            "envcraft: 3 environments: 1 passed, 2 failed, 0 undecided; process isolation; *",
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
        "envcraft_outcome": "fail",
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
    result.assert_outcomes(passed=CHECKS - 1, skipped=1)
    result.stdout.fnmatch_lines(
        ["1.25s setup * games/walk.py::difficulty", "SKIPPED * games/walk.py:8: the search settled nothing"]
    )


def test_an_open_question_is_counted_and_named(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("difficulty", Verdict.SKIP, reason="no episode was won", undecided=True)
    result = run("games", "-rs")
    result.assert_outcomes(passed=CHECKS - 1, skipped=1)
    result.stdout.fnmatch_lines(
        [
            "envcraft: 1 environment: 0 passed, 0 failed, 1 undecided; process isolation*",
            "SKIPPED * games/walk.py:8: undecided: no episode was won",
        ]
    )


def test_an_open_question_that_fails_says_why(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("difficulty", Verdict.FAIL, reason="no episode was won", undecided=True)
    result = run("games")
    result.assert_outcomes(passed=CHECKS - 1, failed=1)
    words = "the check difficulty is undecided and fails under strict in [[]tool.envcraft[]]: no episode was won"
    result.stdout.fnmatch_lines([words])


@pytest.mark.parametrize(("option", "shown"), [("-q", True), ("-qq", False)])
def test_environments_are_counted_where_pytest_counts_tests(
    option: str, shown: bool, walk: Path, run: Run, canned: Canned
) -> None:
    result = run("games", option)
    assert any(line.startswith("envcraft: 1 environment: 1 passed") for line in result.outlines) is shown
    assert any(f"{CHECKS} passed" in line for line in result.outlines) is shown


def test_what_could_not_judge_is_an_error(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("reward", Verdict.ERROR, reason="the worker stopped answering; try again")
    result = run("games", "--junit-xml=junit.xml")
    result.assert_outcomes(passed=CHECKS - 1, errors=1)
    result.stdout.fnmatch_lines(
        [
            "the check reward could not judge games/walk.py, which is not a failure*: the worker stopped *",
            "Try it by itself: envcraft validate games/walk.py --contract arcade --budget quick *",
        ]
    )
    tags = [case.find("error") is not None for case in ElementTree.parse("junit.xml").iter("testcase")]
    assert tags.count(True) == 1


@pytest.fixture
def unavailable(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """No sandbox works; the names of those that were asked for."""
    asked: list[str] = []

    def named(name: str, *_: Any) -> None:
        asked.append(name)
        raise SandboxUnavailable("the sandbox docker does not work here; start the Docker engine")

    monkeypatch.setattr("envcraft.pytest_plugin.judging.driver_named", named)
    return asked


@pytest.mark.parametrize("options", [(), ("-n2",)])
def test_no_sandbox_is_one_error_with_the_next_step(
    walk: Path, run: Run, unavailable: list[str], options: tuple[str, ...]
) -> None:
    if options:
        pytest.importorskip("xdist")
    result = run("games", *options)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    assert result.stderr.lines[0] == "ERROR: the sandbox docker does not work here; start the Docker engine"
    assert "walk.py::" not in result.stdout.str()
    assert unavailable == ["process"]
    assert run("games", "--collect-only").ret == 0


def test_no_sandbox_is_an_error_of_each_marked_test(
    pytester: pytest.Pytester, walk: Path, unavailable: list[str]
) -> None:
    pytester.makepyfile(
        "import pytest\n"
        "@pytest.mark.envcraft('games/walk.py', checks='api')\n"
        "def test_walk(): pass\n"
        "def test_other(): pass\n"
    )
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=3, passed=1)
    result.stdout.fnmatch_lines(["nothing was judged: the sandbox docker does not work here; start the Docker engine"])
    assert unavailable == ["auto"]


def test_a_check_that_breaks_is_an_error(walk: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: Check, subject: object) -> None:
        raise ValueError("out of cheese")

    [reward] = [check for check in all_checks() if check.name == "reward"]
    monkeypatch.setattr(type(reward), "judge", broken)
    result = run("games/walk.py::reward")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*the check raised ValueError: out of cheese"])


def test_warnings_are_shown_and_fail_nothing_unless_a_filter_wants_it(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("determinism", Verdict.PASS, Finding("EC209", Severity.WARNING, "all seeds give one level", 12))
    result = run("games")
    result.assert_outcomes(passed=CHECKS, warnings=1)
    result.stdout.fnmatch_lines(
        ["games/walk.py::determinism", "*games/walk.py:12: EnvCraftWarning: EC209 * one level (fix: *)"]
    )
    result = run("games", "-W", "error::envcraft.pytest_plugin.EnvCraftWarning")
    result.assert_outcomes(passed=CHECKS - 1, failed=1)
    assert "Traceback" not in result.stdout.str()
    assert result.stdout.str().count("all seeds give one level") == 1
    result.stdout.fnmatch_lines(
        [
            "EC209 * games/walk.py:12",
            "  all seeds give one level",
            f"  12 | {walk.read_text().splitlines()[11]}",
            "envcraft: 1 environment: 0 passed, 1 failed, 0 undecided; process isolation*",
        ]
    )


def test_severities_of_the_project_and_comments_apply(walk: Path, run: Run, canned: Canned) -> None:
    config = walk.parent.parent / "pyproject.toml"
    config.write_text('[tool.envcraft.severity]\nEC209 = "error"\n')
    run("games").assert_outcomes(passed=CHECKS)
    assert canned.plans[-1].severity == SeverityPolicy({"EC209": "error"}, comments=True)
    config.write_text('[tool.envcraft.severity]\nEC2O9 = "error"\n')
    result = run("games")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*there is no rule or check 'EC2O9'; did you mean EC209?*"])


def test_filters_of_the_tests_do_not_reach_the_judging(walk: Path, run: Run) -> None:
    walk.write_text(walk.read_text() + "\nPATTERN = '\\d'\n")
    result = run("games/walk.py::api", "-W", "error")
    result.assert_outcomes(passed=1)


def test_checks_that_verdicts_rest_on_show_in_those_selected(walk: Path, run: Run, canned: Canned) -> None:
    canned.set("source", Verdict.FAIL, failing("EC003", "importing raises"))
    for check in ("api", "reward"):
        canned.set(check, Verdict.SKIP, reason="the check source did not pass")
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
