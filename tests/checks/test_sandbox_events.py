"""What a sandbox has to stop is reported with its own code, once, and the checker goes on."""

from __future__ import annotations

import time
from pathlib import Path

import msgspec
import pytest
from envcraft_checks.sandbox import SandboxEvents

from benchmarks.judge import failing
from envcraft.budget import BUDGETS
from envcraft.check import Check
from envcraft.commands.choices import default_checks
from envcraft.contract import ARCADE
from envcraft.engine import Plan, validate
from envcraft.events import SubjectFinished
from envcraft.plugins import plugins
from envcraft.sandbox import Driver, Limits, choose
from envcraft.subject import Subject
from envcraft.target import MAX_SOURCE, read_target
from envcraft.verdict import Finding, SubjectReport, Verdict

GAME = (Path(__file__).resolve().parents[2] / "examples" / "sokoban.py").read_text()
STEP = "        self.steps += 1\n"
LIMITS = Limits(call=1.0, loading=5.0, memory=512 * 1024**2, output_total=256 * 1024)


def judged(tmp_path: Path, source: str, limits: Limits = LIMITS, checks: list[Check] | None = None) -> SubjectReport:
    path = tmp_path / "game.py"
    path.write_text(source)
    checks = default_checks() if checks is None else checks
    plan = Plan([read_target(str(path))], ARCADE, process(), checks, BUDGETS["quick"], limits=limits)
    return next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))


def process() -> Driver:
    return choose(plugins().collect("envcraft_sandbox_drivers"), "process")


def subject_of(path: Path) -> Subject:
    return Subject(read_target(str(path)), ARCADE, process(), BUDGETS["quick"])


@pytest.mark.parametrize(
    ("code", "statement"),
    [
        ("EC901", "while self.steps > 30: pass"),
        ("EC902", "self.kept = getattr(self, 'kept', []) + [bytearray(64 * 1024**2)]"),
        ("EC903", "__import__('os').fork()"),
        ("EC904", "print('x' * 65536)"),
        ("EC904", "open(str(self.steps), 'wb').write(bytes(32 * 1024**2))"),
        ("EC905", "__import__('socket').socket()"),
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
    assert time.monotonic() - started < 240


@pytest.mark.parametrize("statement", ["[].remove(0)", "__import__('os')._exit(3)"])
def test_what_was_printed_is_shown_with_the_finding(tmp_path: Path, statement: str) -> None:
    statement = f"print('about to fail', self.steps, flush=True); self.steps > 30 and {statement}"
    report = judged(tmp_path, GAME.replace(STEP, f"        {statement}\n{STEP}", 1))
    shown = [finding.evidence.get("output", "") for check in report.checks for finding in check.findings]
    assert any("about to fail 31" in output for output in shown)


def test_the_hanging_step_is_named(tmp_path: Path) -> None:
    report = judged(tmp_path, GAME.replace(STEP, f"        while self.steps > 30: pass\n{STEP}", 1))
    (finding,) = next(check for check in report.checks if check.check == "sandbox").findings
    assert finding.message.startswith("step 32 did not end")
    assert len(finding.repro.actions) == 32


def test_a_large_file_fails_source(tmp_path: Path) -> None:
    report = judged(tmp_path, "#" * (MAX_SOURCE + 1))
    assert failing(report) == {"EC010"}
    assert report.steps == 0


def test_all_episodes_together_have_a_limit(tmp_path: Path) -> None:
    slow = GAME.replace(STEP, f"        __import__('time').sleep(0.003)\n{STEP}", 1)
    report = judged(tmp_path, slow, msgspec.structs.replace(LIMITS, total=3.0))
    (finding,) = next(check for check in report.checks if check.check == "sandbox").findings
    assert finding.code == "EC901"
    assert finding.message.startswith("all episodes together took")
    assert any("together" in check.reason for check in report.checks if check.verdict is Verdict.SKIP)


def paced(tmp_path: Path, statement: str) -> list[Finding]:
    """What the check `sandbox` finds in a short game of which each step begins with a statement."""
    game = GAME.replace("MAX_STEPS = 500", "MAX_STEPS = 60").replace(STEP, f"        {statement}\n{STEP}", 1)
    library = "import time" if "time" in statement else "import pygame\nclock = pygame.time.Clock()"
    game = game.replace("import math\n", f"import math\n{library}\n", 1)
    checks = [check for check in default_checks() if check.name in ("source", "reward", "sandbox")]
    return judged(tmp_path, game, checks=checks).checks[-1].findings


@pytest.mark.parametrize("statement", ["time.sleep(1 / 240)", "clock.tick(120)", "time.sleep(0.002)"])
def test_steps_that_wait_for_the_clock(tmp_path: Path, statement: str) -> None:
    (finding,) = paced(tmp_path, statement)
    assert finding.code == "EC908"
    assert finding.evidence["waits"] >= 0.9 * finding.evidence["steps"]
    assert finding.evidence["cpu"] < 1
    assert len(finding.repro.actions) == finding.evidence["steps"]
    with subject_of(tmp_path / "game.py") as subject:
        again = SandboxEvents().confirm(subject, finding)
    assert again is not None
    assert again.code == "EC908"


@pytest.mark.parametrize(
    "statement",
    [
        "sum(range(100_000))",
        "self.steps % 2 and time.sleep(1 / 120)",
        "self.steps or time.sleep(0.5)",
        "self.render_mode == 'human' and clock.tick(30)",
    ],
    ids=["computes", "waits now and then", "waits once", "waits for people"],
)
def test_steps_that_are_slow_or_do_not_all_wait(tmp_path: Path, statement: str) -> None:
    assert not paced(tmp_path, statement)
