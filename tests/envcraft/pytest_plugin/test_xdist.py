"""How often code is run, in one process and in several."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.envcraft.pytest_plugin.stand_in import QUICK

pytest_plugins = ["pytester"]


#: Counts, across processes, how often an environment is run.
COUNTING = """
import envcraft.judging.engine
judge = envcraft.judging.engine.validate
def counted(plan, workers):
    with open("runs.txt", "a") as runs:
        runs.write(plan.targets[0].path + "\\n")
    return judge(plan, workers)
envcraft.judging.engine.validate = counted
"""


@pytest.mark.parametrize(
    "options",
    # Spread item by item, which is the hardest for one run a file.
    [("-p", "no:xdist"), ("-n0",), ("-n2", "--dist", "load")],
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
    result.stdout.fnmatch_lines(
        ["EC003 * games/bad.py:3", "envcraft: 2 environments: 1 passed, 1 failed, 0 undecided; *"]
    )
    assert not list((pytester.path / "tmp").glob("envcraft-????????"))
