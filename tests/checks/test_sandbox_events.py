"""What a sandbox has to stop is reported with its own code, once, and the checker goes on."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from benchmarks.judge import failing
from envcraft.budget import BUDGETS
from envcraft.contract import ARCADE
from envcraft.engine import Plan, validate
from envcraft.events import SubjectFinished
from envcraft.plugins import plugins
from envcraft.sandbox import Limits, choose
from envcraft.subject import MAX_SOURCE, read_target
from envcraft.verdict import SubjectReport, Verdict

GAME = (Path(__file__).resolve().parents[2] / "examples" / "sokoban.py").read_text()
STEP = "        self.steps += 1\n"
LIMITS = Limits(call=1.0, loading=5.0, memory=512 * 1024**2, output_total=256 * 1024)


def judged(tmp_path: Path, source: str) -> SubjectReport:
    path = tmp_path / "game.py"
    path.write_text(source)
    driver = choose(plugins().collect("envcraft_sandbox_drivers"), "process")
    checks = plugins().collect("envcraft_checks")
    plan = Plan([read_target(str(path))], ARCADE, driver, checks, BUDGETS["quick"], limits=LIMITS)
    return next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))


@pytest.mark.parametrize(
    ("code", "statement"),
    [
        ("EC901", "while self.steps > 30: pass"),
        ("EC902", "self.kept = getattr(self, 'kept', []) + [bytearray(64 * 1024**2)]"),
        ("EC904", "print('x' * 65536)"),
        ("EC906", "self.steps > 30 and __import__('os')._exit(3)"),
        ("EC907", "self.steps > 30 and __import__('os').write(3, b'pass' * 64)"),
    ],
)
def test_event(tmp_path: Path, code: str, statement: str) -> None:
    assert STEP in GAME
    started = time.monotonic()
    report = judged(tmp_path, GAME.replace(STEP, f"        {statement}\n{STEP}", 1))
    assert code in failing(report)
    assert report.verdict is Verdict.FAIL
    assert time.monotonic() - started < 60


def test_the_hanging_step_is_named(tmp_path: Path) -> None:
    report = judged(tmp_path, GAME.replace(STEP, f"        while self.steps > 30: pass\n{STEP}", 1))
    (finding,) = next(check for check in report.checks if check.check == "sandbox").findings
    assert finding.message.startswith("step 32 did not end")
    assert len(finding.repro.actions) == 32


def test_a_large_file_fails_source(tmp_path: Path) -> None:
    report = judged(tmp_path, "#" * (MAX_SOURCE + 1))
    assert failing(report) == {"EC010"}
    assert report.steps == 0
