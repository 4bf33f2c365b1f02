"""The checker survives what a sandbox stops, and reports it once with its own code."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, Limits
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import Finished, SubjectFinished
from envcraft.model.target import MAX_SOURCE, Target, read_target
from envcraft.model.verdict import SubjectReport, Verdict
from evaluation.judge import failing

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
    return driver_named("process")


def subject_of(path: Path) -> Subject:
    return Subject(read_target(str(path)), ARCADE, WorkerPool(process()).lease(), BUDGETS["quick"])


HANGS = "while self.steps > 30: pass"
EVENTS = [
    ("EC901", HANGS),
    ("EC902", "self.kept = getattr(self, 'kept', []) + [bytearray(64 * 1024**2)]"),
    ("EC903", "__import__('os').fork()"),
    ("EC904", "print('x' * 65536)"),
    ("EC904", "open(str(self.steps), 'wb').write(bytes(32 * 1024**2))"),
    ("EC905", "__import__('socket').socket()"),
    ("EC906", "import os; self.steps > 30 and os._exit(3)"),
    ("EC907", "self.steps > 30 and __import__('os').write(3, b'pass' * 64)"),
]
PRINTS = [
    f"print('about to fail', self.steps, flush=True); self.steps > 30 and {statement}"
    for statement in ("[].remove(0)", "__import__('os')._exit(3)")
]


@pytest.fixture(scope="module")
def reports() -> dict[str, SubjectReport]:
    """The report on the game with each statement at the start of step()."""
    assert STEP in GAME
    statements = [*(statement for _, statement in EVENTS), *PRINTS]
    games = [GAME.replace(STEP, f"        {statement}\n{STEP}", 1) for statement in statements]
    targets = [Target("game.py", game.encode()) for game in games]
    *_, last = validate(Plan(targets, ARCADE, process(), default_checks(), BUDGETS["quick"], limits=LIMITS))
    assert isinstance(last, Finished)
    return dict(zip(statements, last.report.reports, strict=True))


@pytest.mark.parametrize(("code", "statement"), EVENTS)
def test_event(code: str, statement: str, reports: dict[str, SubjectReport]) -> None:
    report = reports[statement]
    assert code in failing(report)
    assert report.verdict is Verdict.FAIL
    assert report.seconds < 240


@pytest.mark.parametrize(("code", "statement"), [event for event in EVENTS if event[0] != "EC907"])
def test_the_line_of_an_event_is_named(code: str, statement: str, reports: dict[str, SubjectReport]) -> None:
    [line] = {finding.line for check in reports[statement].checks for finding in check.findings if finding.code == code}
    assert line is not None
    assert statement in GAME.replace(STEP, f"        {statement}\n{STEP}", 1).splitlines()[line - 1]


@pytest.mark.parametrize(
    ("before", "loop", "code"),
    [
        ("\nclass ", "while True:\n    pass", "EC004"),
        ("        self.render_mode = ", "        while True:\n            pass", "EC008"),
    ],
    ids=["import", "constructor"],
)
def test_the_loop_that_keeps_a_file_from_loading_is_named(before: str, loop: str, code: str, tmp_path: Path) -> None:
    assert before in GAME
    text = GAME.replace(before, f"\n{loop}\n{before}", 1)
    checks = [check for check in default_checks() if check.name == "source"]
    [finding] = judged(tmp_path, text, Limits(call=1.0, loading=2.0), checks).checks[0].findings
    assert (finding.code, finding.line) == (code, text.splitlines().index(loop.splitlines()[0]) + 1)


#: Statements of a step that are judged together: the code, the line that is named, and what stands before it.
LINES = {
    "call beside a loop": ("EC901", "time.sleep(9)", "while n < 3: n += 1\nif self.steps > 30:\n    time.sleep(9)"),
    "native code": (
        "EC901",
        "max(itertools.count())",
        "while n < 3: n += 1\nself.steps > 30 and max(itertools.count())",
    ),
    "call in a loop": (
        "EC901",
        "re.match(",
        "while n < 3: n += 1\nfor n in range(2):\n    if self.steps > 30:\n        re.match('(a+)+$', 'a' * 40 + 'b')",
    ),
    "long loop": ("EC901", "for n in range(10**12):", "while n < 3: n += 1\nfor n in range(10**12):\n    self.n = n"),
    "helper": ("EC901", "while n < 9:", "while n < 3: n += 1\nn = 3\nwhile n < 9:\n    free(n)"),
    "flood": ("EC904", "print('x' * 65536)", "n and print('x')\nprint('x' * 65536)"),
    "crash": ("EC906", "ctypes.string_at(0)", "self.steps > 30 and ctypes.string_at(0)"),
}


class Lined:
    """Reports of the game with each of these statements in step(). A second request, by a rerun, judges it again."""

    def __init__(self) -> None:
        self._unread = self._judged([*LINES])

    def take(self, name: str) -> tuple[str, SubjectReport]:
        return self._unread.pop(name, None) or self._judged([name])[name]

    def _judged(self, names: list[str]) -> dict[str, tuple[str, SubjectReport]]:
        top = "import ctypes, itertools, re, time\ndef free(n):\n    return [n for _ in range(9)]\n"
        game = GAME.replace("import gymnasium", f"{top}import gymnasium", 1)
        texts = []
        for name in names:
            lines = "".join(f"        {line}\n" for line in ["n = 0", *LINES[name][2].splitlines()])
            texts.append(game.replace(STEP, f"{STEP}{lines}", 1))
        targets = [Target("game.py", text.encode()) for text in texts]
        checks = [check for check in default_checks() if check.name in ("source", "api", "sandbox")]
        *_, last = validate(Plan(targets, ARCADE, process(), checks, BUDGETS["quick"], limits=LIMITS))
        assert isinstance(last, Finished)
        return dict(zip(names, zip(texts, last.report.reports, strict=True), strict=True))


@pytest.fixture(scope="module")
def lined() -> Lined:
    return Lined()


@pytest.mark.parametrize("name", LINES)
def test_the_line_that_was_running_is_named(name: str, lined: Lined) -> None:
    code, statement, _ = LINES[name]
    text, report = lined.take(name)
    [finding] = [one for check in report.checks for one in check.findings if one.code == code]
    assert finding.line is not None
    assert statement in text.splitlines()[finding.line - 1]
    assert "most recent call first" not in finding.evidence.get("output", "")


@pytest.mark.parametrize("statement", PRINTS)
def test_output_is_part_of_the_finding(statement: str, reports: dict[str, SubjectReport]) -> None:
    findings = [finding for check in reports[statement].checks for finding in check.findings]
    assert any("about to fail 31" in finding.evidence.get("output", "") for finding in findings)


def test_the_hanging_step_is_named(reports: dict[str, SubjectReport]) -> None:
    (finding,) = next(check for check in reports[HANGS].checks if check.check == "sandbox").findings
    assert finding.message.startswith("step 32 did not end")
    assert finding.line is not None
    assert GAME.replace(STEP, f"        {HANGS}\n{STEP}", 1).splitlines()[finding.line - 1].strip() == HANGS
    assert len(finding.repro.actions) == 32


def test_a_large_file_fails_source(tmp_path: Path) -> None:
    report = judged(tmp_path, "#" * (MAX_SOURCE + 1))
    assert failing(report) == {"EC010"}
    assert report.steps == 0


def test_what_is_not_settled_in_time_is_skipped(tmp_path: Path) -> None:
    target = Target("game.py", GAME.replace(STEP, f"        __import__('time').sleep(0.003)\n{STEP}", 1).encode())
    plan = Plan([target], ARCADE, process(), default_checks(), BUDGETS["quick"], limits=LIMITS, time_limit=6)
    started = time.monotonic()
    report = next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))
    assert time.monotonic() - started < 15
    assert failing(report) == {"EC908"}
    assert report.out_of_time
    late = [check for check in report.checks if check.reason == "out of time: the limit of 6 s is reached"]
    assert late
    assert {check.verdict for check in late} == {Verdict.SKIP}
