"""Slow environments are reported from a short episode, and those that only look slow are not."""

from __future__ import annotations

import textwrap
import time
from pathlib import Path
from typing import Any

import msgspec
import pytest
from envcraft_checks.speed import Speed, growth, pace

import envcraft
from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named
from envcraft.judging.subject import Subject
from envcraft.judging.trace_builder import MeasuredTraceBuilder
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.contract import Contract
from envcraft.model.events import SubjectFinished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, SubjectReport

GAME = (Path(__file__).resolve().parents[2] / "examples" / "sokoban.py").read_text()
STEP = "        self.steps += 1\n"
RESET = "        super().reset(seed=seed)\n"
#: Uses the processor for some seconds. Some kernels count its time in ticks of milliseconds.
BUSY = """def spin(times):
    for _ in range(times):
        pass


started = time.process_time()
spin(3_000_000)
EACH = (time.process_time() - started) / 3_000_000


def busy(seconds):
    spin(int(seconds / EACH))

"""


def game(step: str = "pass", reset: str = "pass") -> Target:
    assert STEP in GAME
    assert RESET in GAME
    source = GAME.replace(STEP, f"        {step}\n{STEP}", 1).replace(RESET, f"{RESET}        {reset}\n", 1)
    library = "import time" if "clock" not in step else "import pygame\nimport time\nclock = pygame.time.Clock()"
    return Target("game.py", source.replace("import math\n", f"import math\n{library}\n{BUSY}", 1).encode())


def judged(target: Target, contract: Contract = ARCADE) -> SubjectReport:
    checks = [check for check in default_checks() if check.name in ("source", "speed")]
    plan = Plan([target], contract, driver_named("process"), checks, BUDGETS["quick"])
    return next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))


def found(target: Target, contract: Contract = ARCADE) -> list[Finding]:
    (own,) = [check for check in judged(target, contract).checks if check.check == "speed"]
    assert not own.reason
    return own.findings


@pytest.mark.parametrize("step", ["time.sleep(0.05)", "time.sleep(1 / 240)", "clock.tick(120)", "time.sleep(0.002)"])
def test_steps_that_wait(step: str) -> None:
    target, started = game(step), time.monotonic()
    (finding,) = found(target)
    assert time.monotonic() - started < 30
    assert finding.code == "EC908"
    assert finding.evidence["waits"] >= 0.9 * finding.evidence["steps"]
    assert len(finding.repro.actions) == finding.evidence["steps"]
    line = target.source.decode().splitlines().index(f"        {step}") + 1
    assert (finding.line, f"line {line} waits: {step}" in finding.message) == (line, True)
    lease = WorkerPool(driver_named("process")).lease()
    with Subject(target, ARCADE, lease, BUDGETS["quick"]) as subject:
        again = Speed().confirm(subject, finding)
    assert again is not None
    assert again.code == "EC908"


def test_a_step_that_costs_more_each_time() -> None:
    started = time.monotonic()
    (finding,) = found(game("busy(self.steps * 3e-4)"))
    assert time.monotonic() - started < 40
    assert finding.code == "EC909"
    assert "longer and longer" in finding.message
    assert "at step 1,000" in finding.message
    assert 0.1 < finding.evidence["at_limit"] < 1.2


def test_steps_that_compute_for_too_long() -> None:
    (finding,) = found(game("busy(0.2)"))
    assert finding.code == "EC909"
    assert finding.evidence["steps_per_second"] == pytest.approx(5, rel=0.4)
    assert "requires 20" in finding.message
    assert finding.line is not None


def test_some_steps_that_wait_long() -> None:
    """An animation that is drawn at a fixed rate waits, although most steps do not."""
    (finding,) = found(game("time.sleep(0.4 * (self.steps % 4 == 0))"))
    assert finding.code == "EC909"
    assert "mostly waiting" in finding.message


def test_steps_of_nearly_a_second() -> None:
    started = time.monotonic()
    assert [finding.code for finding in found(game("busy(0.9)"))] == ["EC909"]
    assert time.monotonic() - started < 30


def test_the_contract_says_what_is_slow() -> None:
    target = game("busy(0.01)")
    assert not found(target)
    strict = msgspec.structs.replace(ARCADE, min_steps_per_second=500.0)
    assert [finding.code for finding in found(target, strict)] == ["EC909"]
    assert not found(game("busy(0.1)"), msgspec.structs.replace(ARCADE, min_steps_per_second=0.0))


@pytest.mark.parametrize(("reset", "code"), [("time.sleep(1)", "EC908"), ("busy(1)", None)])
def test_a_reset_that_takes_long_each_time(reset: str, code: str | None) -> None:
    # A second an episode of up to 500 steps is fine, and waiting never is.
    assert [finding.code for finding in found(game(reset=reset))] == [code] * (code is not None)


@pytest.mark.parametrize(
    "step",
    [
        "busy(1 / 60)",
        "self.steps or busy(1)",
        "self.steps or time.sleep(0.5)",
        "self.steps % 25 or busy(0.3)",
        "self.steps % 2 and time.sleep(1 / 120)",
        "busy(min(self.steps, 50) * 1e-4)",
        "busy(0.004 if self.steps > 60 else 0.001)",
        "self.render_mode == 'human' and clock.tick(30)",
    ],
    ids=["60 a second", "slow first", "waits once", "slow now and then", "waits now and then", "grows for a while",
         "two phases", "waits for people"],
)  # fmt: skip
def test_near_misses(step: str) -> None:
    assert not found(game(step))


def test_a_first_reset_that_loads() -> None:
    assert not found(game(reset="globals().get('LOADED') or globals().update(LOADED=time.sleep(1) or True)"))


def test_the_machines_load_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    # The clock says 60 ms for each step, and the processor 10 ms.
    finish = MeasuredTraceBuilder.end

    def late(self: MeasuredTraceBuilder) -> None:
        for step in range(1, len(self.trace.costs)):
            self.trace.costs[step] = 60_000
        finish(self)

    monkeypatch.setattr("envcraft.judging.trace_builder.MeasuredTraceBuilder.end", late)
    assert not found(game("busy(0.01)"))
    assert [finding.code for finding in found(game("busy(0.2)"))] == ["EC909"]


@pytest.mark.parametrize(
    ("reset", "reason"),
    [
        ("raise ValueError", "reset() does not return an observation and info"),
        ("while True: pass", "reset() did not return: see the check sandbox"),
    ],
    ids=["raises", "endless"],
)
def test_without_a_reset_nothing_is_measured(reset: str, reason: str) -> None:
    (own,) = [check for check in judged(game(reset=reset)).checks if check.check == "speed"]
    assert (own.undecided, own.reason) == (True, reason)


def test_pace_leaves_the_most_expensive_steps_out() -> None:
    assert pace([10_000] * 100) == pytest.approx(100)
    assert pace([10_000] * 96 + [3_000_000] * 4) == pytest.approx(100)
    assert pace([10_000] * 80 + [3_000_000] * 20) < 20
    assert pace([50_000]) == pytest.approx(20)


def test_growth_is_steady_and_large() -> None:
    growing = growth([100 * step for step in range(1, 201)])
    assert growing is not None
    assert growing.at(1000) == pytest.approx(100_000, rel=0.05)
    assert growth([100 * step for step in range(1, 50)]) is None
    assert growth([1_000] * 200) is None
    assert growth([1_000] * 150 + [9_000] * 50) is None
    assert growth([1_000 + 10 * step for step in range(150)]) is None
    assert growth([10_000 * (step % 50) for step in range(200)]) is None
    assert growth(list(range(200))) is None


def test_a_reset_without_a_seed_is_named_as_the_reason() -> None:
    source = "import gymnasium as gym\n\nclass Old(gym.Env):\n" + textwrap.indent(
        "observation_space = action_space = gym.spaces.Discrete(2)\n"
        "def reset(self):\n    return 0\n"
        "def step(self, action):\n    return 0, 0.0, True, {}\n",
        "    ",
    )
    options: Any = {"sandbox": "process", "budget": "quick", "contract": "gymnasium", "checks": "speed,determinism"}
    [report] = envcraft.validate(source, **options).reports
    reasons = {check.check: check.reason for check in report.checks}
    assert reasons["speed"] == reasons["determinism"] == "reset() does not take seed="
