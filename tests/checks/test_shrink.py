"""Reproductions are made as short as a few tries allow, and still show the defect."""

from __future__ import annotations

from typing import Any

import pytest
from envcraft_checks.api import Api
from envcraft_checks.reward import Reward
from envcraft_checks.sandbox import SandboxEvents
from envcraft_checks.source import Source
from envcraft_checks.termination import Termination

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import Skip
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.judging.shrink import shrink
from envcraft.model.events import Finished
from envcraft.model.rollout import Rollout
from envcraft.model.target import Target
from envcraft.model.trace import Fault, Trace
from envcraft.model.verdict import Finding
from evaluation.fixtures import FIXTURES

GONG = (FIXTURES / "api" / "bad" / "crash_after_three.py").read_text()
CRASH = "reward = 0.01 * bars[bar]"


def found(source: str, *checks: Check) -> dict[str, Finding]:
    target = Target("game.py", source.encode())
    plan = Plan([target], ARCADE, driver_named("process"), [Source(), *checks], BUDGETS["quick"])
    *_, last = validate(plan)
    assert isinstance(last, Finished)
    (report,) = last.report.reports
    return {finding.code: finding for check in report.checks for finding in check.findings}


def test_a_crash_after_three_steps_is_reported_with_those() -> None:
    finding = found(GONG, Api())["EC107"]
    assert len(finding.repro.actions) == 3
    assert finding.repro.actions[-1] == [4, 1, 1]
    assert finding.evidence["step"] == 3
    assert "step 3 raises IndexError" in finding.message


@pytest.mark.parametrize(
    ("line", "code", "check"),
    [
        ("reward = 0.01 if bar < 3 else float('nan')", "EC301", Reward()),
        ("reward = 0.01 if bar < 3 else 1e9", "EC303", Reward()),
        ("reward = 0.01 if bar < 3 else 'much'", "EC302", Reward()),
        ("bar < 3 or __import__('os')._exit(7)", "EC906", SandboxEvents()),
    ],
)
def test_other_defects_of_one_trace_are_shrunk(line: str, code: str, check: Check) -> None:
    source = GONG.replace(CRASH, line).replace("if won:\n            reward +=", "if won:\n            reward =")
    assert source != GONG
    checks = [check] if isinstance(check, Reward) else [Reward(), check]
    finding = found(source, *checks)[code]
    assert len(finding.repro.actions) == 3
    assert finding.repro.actions[-1] == [4, 1, 1]


def test_a_flag_of_the_wrong_type_is_shrunk() -> None:
    source = GONG.replace(CRASH, "self.odd = bar == 3").replace("self.facing = 0", "self.odd = False")
    source = source.replace("reward, won, truncated", "reward, won or ('no' if self.odd else False), truncated")
    finding = found(source, Termination())["EC504"]
    assert len(finding.repro.actions) == 3


# A game on a line: the player starts at 0, and moving on from place 4 fails. Time goes on in any case.


class Line:
    """Plays rollouts, and counts them and their steps."""

    def __init__(self, timed: int = 0, seen: bool = True, most: int = 10**9) -> None:
        self.timed = timed
        self.seen = seen
        self.most = most
        self.rollouts = 0
        self.steps = 0

    def play(self, rollout: Rollout) -> Trace:
        self.rollouts += 1
        if self.rollouts > self.most:
            raise Skip("the time is over")
        self.steps += len(rollout.actions)
        at = 0
        trace = Trace(rollout, observations=[b"0"])
        for step, action in enumerate(rollout.actions, 1):
            if (at == 4 and action == 1) or step == self.timed:
                trace.fault = Fault("step", step, "IndexError")
                break
            at = max(at + action, 0)
            trace.rewards.append(0.0)
            trace.terminated.append(False)
            trace.truncated.append(False)
            trace.observations.append(b"%d" % at if self.seen else b"%d" % step)
        return trace

    def shrunk(self, actions: list[Any], noop: Any = 0, **bounds: int) -> list[Any]:
        self.given = len(actions)
        rollout = Rollout(0, actions)
        fault = self.play(rollout).fault
        assert fault is not None
        self.rollouts = self.steps = 0
        return shrink(rollout, [fault.step], self.play, shown, noop, **bounds).actions


def shown(trace: Trace) -> int | None:
    return trace.fault.step if trace.fault is not None else None


WALK = [0, 1, -1, 1, 1, 0, -1, 1, 1, -1, -1, 1, 1, 0, 0, 1, 1, 1, 0, -1]


def test_a_detour_is_left_out_at_once() -> None:
    line = Line()
    assert line.shrunk(WALK) == [1] * 5
    assert line.rollouts < 16


def test_where_no_state_is_seen_twice_parts_are_removed() -> None:
    line = Line(seen=False)
    assert line.shrunk(WALK) == [1] * 5
    assert line.steps < 400


def test_what_time_brings_needs_no_actions() -> None:
    assert Line(timed=9).shrunk([1, -1] * 10) == [0] * 9
    assert Line(timed=9).shrunk([1, -1] * 10, noop=None) == [1, -1, 1, -1, 1, -1, 1, -1, 1]


@pytest.mark.parametrize("bounds", [{"tries": 3}, {"steps": 30}])
def test_the_attempts_are_bounded(bounds: dict[str, int]) -> None:
    line = Line(seen=False)
    actions = line.shrunk([-1, 1] * 20 + [1] * 9, **bounds)
    assert 5 <= len(actions) <= 49
    # Besides them only what is known already: the cut, and the smallest one.
    assert line.rollouts <= bounds.get("tries", 30) * 2 + 2
    assert line.steps <= bounds.get("steps", 49 * 3) * 2 + 2 * 49


def test_what_is_known_remains_if_no_more_may_run() -> None:
    for most in range(12):
        line = Line(most=10**9)
        line.shrunk(WALK)
        line = Line(seen=False)
        rollout = Rollout(0, WALK)
        line.most = most
        actions = shrink(rollout, [18], line.play, shown, 0).actions
        assert shown(Line().play(Rollout(0, actions))) is not None


def test_the_actions_of_a_policy_are_only_cut() -> None:
    rollout = Rollout(0, WALK, policy=True, max_steps=len(WALK))
    line = Line()
    assert shrink(rollout, [18], line.play, shown, 0).policy
    assert line.rollouts <= 1
