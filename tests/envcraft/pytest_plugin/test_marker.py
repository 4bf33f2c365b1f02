"""The marker and the fixture."""

from __future__ import annotations

from pathlib import Path

import pytest

import envcraft.pytest_plugin
from envcraft.model.verdict import Verdict
from tests.envcraft.pytest_plugin.stand_in import Canned, failing, outcomes

pytest_plugins = ["pytester"]


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
        ("checks='api'", "*marker envcraft of test_it names no target, and the test does not take the fixture *"),
        ("3", "*marker envcraft of test_it is invalid: 3 is not a target: *"),
        (
            "'games/wlak.py'",
            "*marker envcraft of test_it is invalid: games/wlak.py does not exist in /*root folder; name *",
        ),
        ("'games/walk'", "*games/walk does not exist in /*, pytest's root folder; did you mean games/walk.py[?]"),
        ("'games'", "*marker envcraft of test_it is invalid: /*games holds 2 environments, and a test judges one*"),
        ("'games/walk.py', checks='apu'", "*marker envcraft of test_it is invalid: there is no check 'apu'; *"),
    ],
)
def test_a_wrong_marker_is_a_sentence(pytester: pytest.Pytester, walk: Path, marker: str, sentence: str) -> None:
    (walk.parent / "run.py").write_text(walk.read_text())
    pytester.makepyfile(f"import pytest\n@pytest.mark.envcraft({marker})\ndef test_it(): pass")
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines([sentence])
    assert "pytest_plugin" not in result.stdout.str()
    assert "another exception" not in result.stdout.str()


@pytest.mark.parametrize("decorated", ["def test_it(): pass", "class TestIt:\n    def test_it(self, envcraft): pass"])
def test_a_marker_that_marks_its_target_is_a_sentence(pytester: pytest.Pytester, decorated: str) -> None:
    pytester.makepyfile(
        game="class Game:\n    def __init__(self, a): ...\n    def reset(self): ...\n    def step(self, action): ...",
        test_it=f"import game\nimport pytest\n@pytest.mark.envcraft(game.Game)\n{decorated}",
    )
    pytester.syspathinsert()
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(
        ["the marker envcraft(Game) marks Game itself, not a test; write envcraft(target=Game)"]
    )


def test_a_class_whose_base_is_in_another_folder_is_judged(pytester: pytest.Pytester, walk: Path) -> None:
    pytester.makepyprojecttoml("[tool.pytest.ini_options]\npythonpath = ['src']")
    pytester.mkdir("src")
    walk.rename("src/walk_base.py")
    (pytester.mkdir("tests") / "test_it.py").write_text(
        "import pytest\nfrom walk_base import Walk\n\n"
        "class Local(Walk):\n    pass\n\n"
        "@pytest.mark.envcraft(target=Local, contract='gymnasium', checks='source', sandbox='process')\n"
        "def test_marked(): pass\n\n"
        "def test_called():\n"
        "    import envcraft as ec\n"
        "    options = {'contract': 'gymnasium', 'checks': 'source', 'sandbox': 'process'}\n"
        "    [report] = ec.validate(Local, **options).reports\n"
        "    assert report.verdict == 'pass', report.reason\n"
    )
    pytester.runpytest_inprocess("tests").assert_outcomes(passed=3)


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
        ["*Local is defined inside a function or class; *", "*builtins.int is not defined in a file*"]
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
        "test_wrong": "ERROR",
        "test_defaults": "PASSED",
    }
    result.stdout.fnmatch_lines_random(
        [
            "EC107 * games/walk.py:9",
            "  envcraft validate games/walk.py --checks source,api,sandbox *",
            "the check reward could not judge games/walk.py, *: lost",
            "nothing was judged: games/nowhere.py does not exist in /*, pytest's root folder; *",
            "nothing was judged: the target is missing: *",
            "nothing was judged: there is no option 'cheks'; did you mean checks[?]",
            "nothing was judged: */games holds 2 environments, *",
        ]
    )
    # What was asked for twice ran once.
    assert [plan.seed for plan in canned.plans] == [0, 3, 0, 4]
    result.stdout.fnmatch_lines(["envcraft: 1 environment: 0 passed, 1 failed, 0 undecided; process isolation*"])


def test_the_documented_example_shows_the_findings(pytester: pytest.Pytester, walk: Path, canned: Canned) -> None:
    canned.set("api", Verdict.FAIL, failing("EC107", "step() raises", 9))
    walk.with_name("snake.py").write_text(walk.read_text().replace("class Walk", "class Snake"))
    pytester.syspathinsert("games")
    section = str(envcraft.pytest_plugin.__doc__).partition("## The fixture")[2]
    example = section.partition("```python\n")[2].partition("```")[0]
    pytester.makepyfile(test_it=f"from snake import Snake\n{example}")
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider")
    result.assert_outcomes(failed=2)
    result.stdout.fnmatch_lines(["*_ test_snake _*", "EC107 *", "*_ test_only_what_is_known _*", "E *'EC107'*"])


@pytest.mark.parametrize("options", [(), ("-n1",)], ids=" ".join)
def test_the_summary_counts_what_the_fixture_judges(
    pytester: pytest.Pytester, walk: Path, canned: Canned, options: tuple[str, ...]
) -> None:
    if options:
        pytest.importorskip("xdist")
        # The engine is replaced in this process only.
        checks = "sandbox"
    else:
        canned.set("difficulty", Verdict.SKIP, reason="no episode was won", undecided=True)
        checks = "difficulty"
    (walk.parent / "also.py").write_text(walk.read_text())
    pytester.makepyfile(
        test_it=f"""
        def test_both(envcraft):
            for name in ("walk", "also", "walk"):
                envcraft.check(f"games/{{name}}.py", checks="{checks}", sandbox="process", budget="quick")
        """
    )
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", *options)
    result.assert_outcomes(passed=1)
    counts = "2 passed, 0 failed, 0 undecided" if options else "0 passed, 0 failed, 2 undecided"
    result.stdout.fnmatch_lines([f"envcraft: 2 environments: {counts}; process isolation*"])
