"""What is collected, and that nothing is imported for it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from envcraft.corpus.store import Store
from envcraft.environments.targets import environments_below
from envcraft.model.verdict import Verdict
from envcraft.pytest_plugin.collection import defines_tests, environment_line
from tests.envcraft.conftest import ENVIRONMENT
from tests.envcraft.pytest_plugin.stand_in import TRAP, Canned, Run, failing, outcomes

pytest_plugins = ["pytester"]


#: What loading the plugin imports of EnvCraft.
OWN = ("pytest_plugin", "pytest_plugin.settings", "version")
HEAVY = ("numpy", "gymnasium", "msgspec", "click", "rich", "envcraft.judging.engine", "envcraft.pytest_plugin.judging")


def test_loading_the_plugin_imports_nothing_but_itself() -> None:
    code = (
        "import sys, pytest\nbefore = set(sys.modules)\nimport envcraft.pytest_plugin\n"
        "print(*sorted(set(sys.modules) - before))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip().split() == ["envcraft", *(f"envcraft.{name}" for name in OWN)]


@pytest.mark.parametrize("flag", [(), ("--envcraft", "--collect-only")])
def test_a_run_that_judges_nothing_loads_nothing(pytester: pytest.Pytester, walk: Path, flag: tuple[str, ...]) -> None:
    pytester.makepyfile(test_own="def test_own(): pass")
    heavy = HEAVY if not flag else ("numpy", "gymnasium", "envcraft.judging.engine")
    pytester.makeconftest(
        f"import sys\ndef pytest_unconfigure(): print('loaded', [n for n in {heavy!r} if n in sys.modules])"
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider", *flag)
    result.stdout.fnmatch_lines(["loaded []"])
    if not flag:
        result.assert_outcomes(passed=1)
        assert "envcraft:" not in result.stdout.str()
        assert "games" not in result.stdout.str()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--envcraft",), "envcraft: there is no environment here: no .py file defines a subclass of gymnasium.Env"),
        (("--envcraft-budget", "quick"), "envcraft: --envcraft-budget collects nothing; add --envcraft"),
    ],
)
def test_a_run_without_tests_says_why(pytester: pytest.Pytester, options: tuple[str, ...], words: str) -> None:
    pytester.mkdir("empty")
    result = pytester.runpytest_inprocess("-p", "no:cacheprovider", *options, "empty")
    assert result.ret == pytest.ExitCode.NO_TESTS_COLLECTED
    result.stdout.fnmatch_lines([words])


def test_a_corpus_is_not_collected(walk: Path, run: Run, canned: Canned) -> None:
    with Store.create(Path("corpus")) as store:
        store.add("walk", walk.read_bytes())
    assert list(Path("corpus").rglob("*.py"))
    assert {test.partition("::")[0] for test in outcomes(run(".", "-v"))} == {"games/walk.py"}
    result = run("corpus")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: corpus is a corpus, not a folder of environments; judge it with *"])


def test_the_plugin_can_be_left_out(pytester: pytest.Pytester, walk: Path) -> None:
    result = pytester.runpytest_inprocess("-p", "no:envcraft", "--envcraft")
    result.stderr.fnmatch_lines(["*unrecognized arguments: --envcraft*"])


@pytest.mark.parametrize(
    ("source", "line"),
    [
        ("import gymnasium as gym\n\nclass Snake(gym.Env):\n    pass\n", 3),
        ("from gymnasium import Env\nclass Snake(Env[int, int]): pass\n", 2),
        ("from minigrid.minigrid_env import MiniGridEnv\nclass A: pass\n\nclass B(MiniGridEnv): pass\n", 4),
        ("import gymnasium\nclass A:\n    def reset(self): ...\n    def step(self): ...\n", None),
        ("import gym\nclass A(gym.Env)\n    pass\n", 1),
        ("import gymnasium\nclass A(gymnasium.Env):\n    x = " + "(" * 5_000, 1),
        ("import gymnasium\nclass A(gymnasium.Wrapper):\n    def reset(self): ...\n    def step(self): ...\n", None),
        ("import gymnasium\nclass A: pass\ndef make(): ...\n", None),
        ("import gymnasium as gym\nRoot = gym.Env\nclass C(Root): pass\n", 3),
        ("from gymnasium.envs.toy_text import *\nclass J(FrozenLakeEnv): pass\n", 2),
        ("from base import Walk\nclass Grid(Walk): pass\n", 2),
        ("'about gymnasium'\nclass Snake(Env): pass\n", None),
        ("from .gymnasium import Env\nclass Snake(Env): pass\n", None),
        ("class Snake(Env)  # no Python, nor about it\n", None),
    ],
)
def test_what_is_an_environment_is_told_by_the_source(tmp_path: Path, source: str, line: int | None) -> None:
    (tmp_path / "base.py").write_text(ENVIRONMENT)
    path = tmp_path / "a.py"
    path.write_text(source)
    assert environment_line(path) == line


def test_the_same_files_are_collected_as_are_validated(pytester: pytest.Pytester, walk: Path, run: Run) -> None:
    sources = {
        "alias": "import gymnasium as gym\nRoot = gym.Env\nclass C(Root): pass\n",
        "grid": "from walk import Walk\nclass Grid(Walk): pass\n",
        "abstract": "import gymnasium\nclass A(gymnasium.Env):\n    def step(self, a): raise NotImplementedError\n",
        "alike": "import gymnasium\nclass A:\n    def reset(self): ...\n    def step(self): ...\n",
        "root": "import gymnasium\nclass Root(gymnasium.Env): pass\n",
        "tree": "from root import Root\nclass Tree(Root):\n    def reset(self): ...\n    def step(self, a): ...\n",
        "wraps": "import gymnasium\nclass A(gymnasium.Wrapper): pass\n",
    }
    for name, source in sources.items():
        (walk.parent / name).with_suffix(".py").write_text(source)
    result = run("--collect-only", "-q", "games", "--envcraft-checks=source")
    collected = {line.partition("::")[0] for line in result.outlines if "::" in line}
    assert collected == {target.path for target in environments_below("games")}
    assert collected == {"games/alias.py", "games/grid.py", "games/tree.py", "games/walk.py"}
    assert run("--collect-only", "-q", "games/root.py", "games/tree.py").outlines[0].startswith("games/root.py::")


def test_a_file_that_cannot_be_read_counts_and_is_then_an_error(tmp_path: Path) -> None:
    # Reading the first byte of a process's memory fails, for the superuser too.
    (tmp_path / "game.py").symlink_to("/proc/self/mem")
    assert environment_line(tmp_path / "game.py") == 1


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
    assert list(outcomes(result).values()) == ["PASSED", "PASSED", "PASSED", "FAILED"]
    result = pytester.runpytest_inprocess("--envcraft", "--lf", "-v", "games")
    assert outcomes(result) == {"games/walk.py::determinism": "FAILED"}
    assert len(canned.plans) == 2
