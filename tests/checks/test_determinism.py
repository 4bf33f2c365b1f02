"""Which differences the check determinism reports, on traces that depend on the conditions in a known way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest
from envcraft_checks.determinism import Determinism

import envcraft
from envcraft.judging.budget import BUDGETS
from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout
from envcraft.model.target import Kind, Target
from envcraft.model.trace import Fault, Trace
from envcraft.model.verdict import Finding

CLOCK, BEFORE = Conditions(clock=ClockShift(1.0, 2.0)), Conditions(before=[Episode(1, [])])
RENDER = Conditions(render=True)
ALL = Conditions(fresh=True, heap=1, clock=CLOCK.clock, before=BEFORE.before, render=True)


class Played:
    """A subject whose first observation tells the conditions that it depends on."""

    target = Target("Walk-v0", kind=Kind.ID)
    installed_source = b""
    budget = BUDGETS["quick"]

    def __init__(self, *causes: str) -> None:
        self._causes = causes

    def rollout(self, rollout: Rollout, alone: bool = False) -> Trace:
        return Trace(rollout, observations=[b"%d" % self._differs(rollout.conditions)], infos=[b"{}"])

    def _differs(self, conditions: Conditions) -> bool:
        return any(getattr(conditions, cause) for cause in self._causes)

    rerun = rollout

    def prefetch(self, *_: Any, **__: Any) -> None: ...

    def affords(self, steps: int) -> bool:
        return True

    def line_of(self, method: str) -> int | None:
        return None


class Late(Played):
    """One that ends after some time, which passes in many episodes or by a fast clock."""

    def _differs(self, conditions: Conditions) -> bool:
        rate = conditions.clock.rate if conditions.clock else 1
        return rate * (1 + len(conditions.before)) > 3


class Both(Played):
    """One that differs only if render() is called after earlier episodes."""

    def _differs(self, conditions: Conditions) -> bool:
        return bool(conditions.before and conditions.render)


class Daytime(Played):
    """One that reads the time of day, which differs in each run but the plain one, unless the clock is held."""

    target = Target("day.py", b"", Kind.SOURCE)
    class_statement = None
    text = (
        "import time\nimport gymnasium as gym\nclass Day(gym.Env):\n    def step(self, action):\n"
        "        return time.time() % 2 < 1, 0.0, False, False, {}\n"
    )

    def _differs(self, conditions: Conditions) -> bool:
        held = conditions.clock is not None and conditions.clock.rate == 0
        return not held and conditions != Conditions()


@pytest.fixture
def compared(monkeypatch: pytest.MonkeyPatch) -> Callable[[Any], list[Finding]]:
    """The findings of one episode of a subject."""
    alone = [("EC205", CLOCK, "clock"), ("EC206", BEFORE, "before"), ("EC208", RENDER, "render")]
    monkeypatch.setattr("envcraft_checks.comparing.conditions.alone", lambda subject, rollout: alone)
    monkeypatch.setattr("envcraft_checks.comparing.conditions.together", lambda subject, rollout, left_out: ALL)
    monkeypatch.setattr("envcraft_checks.comparing.causes.reset_again", lambda subject, rollout, info: None)
    return lambda subject: list(Determinism()._compare(subject, Rollout(0, []), True))


@pytest.mark.parametrize(
    ("causes", "codes"), [(("clock", "before"), ["EC205"]), (("before",), ["EC206"]), (("clock",), ["EC205"]), ((), [])]
)
def test_an_episode_that_depends_on_the_clock_has_no_other_cause(
    causes: tuple[str, ...], codes: list[str], compared: Callable[[Any], list[Finding]]
) -> None:
    assert [finding.code for finding in compared(Played(*causes))] == codes


@pytest.mark.parametrize(
    ("subject", "code", "conditions"), [(Late(), "EC205", {"clock"}), (Both(), "EC206", {"before", "render"})]
)
def test_a_difference_has_only_the_conditions_that_it_takes(
    subject: Played, code: str, conditions: set[str], compared: Callable[[Any], list[Finding]]
) -> None:
    [finding] = compared(subject)
    assert (finding.code, set(finding.repro.conditions)) == (code, conditions)


def test_the_time_of_day_is_not_taken_for_the_process(compared: Callable[[Any], list[Finding]]) -> None:
    [finding] = compared(Daytime())
    assert (finding.code, finding.line) == ("EC205", 5), finding.message


class Crashing(Played):
    """One that raises in earlier episodes, and perhaps depends on other conditions."""

    def __init__(self, *causes: str) -> None:
        super().__init__(*causes)
        self.played: list[Conditions] = []

    def rollout(self, rollout: Rollout, alone: bool = False) -> Trace:
        self.played.append(rollout.conditions)
        trace = super().rollout(rollout)
        if rollout.conditions.before:
            trace.observations.clear()
            trace.fault = Fault("before", 0, "IndexError")
        return trace

    rerun = rollout


@pytest.mark.parametrize(("causes", "codes"), [((), []), (("clock",), ["EC205"]), (("render",), ["EC208"])])
def test_earlier_episodes_that_raise_are_left_out(
    causes: tuple[str, ...], codes: list[str], compared: Callable[[Any], list[Finding]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def together(subject: Any, rollout: Rollout, left_out: frozenset[str]) -> Conditions:
        return msgspec.structs.replace(ALL, before=[]) if "before" in left_out else ALL

    monkeypatch.setattr("envcraft_checks.comparing.conditions.together", together)
    subject = Crashing(*causes)
    assert [finding.code for finding in compared(subject)] == codes
    # All conditions differ in nothing, so none is tried alone but the earlier episodes.
    assert codes or (BEFORE in subject.played and CLOCK not in subject.played)


def test_success_that_is_kept_is_no_telemetry() -> None:
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick"}
    report = envcraft.validate(WON, checks="determinism", **options)
    [finding] = [finding for check in report.reports[0].checks for finding in check.findings]
    assert (finding.code, finding.line) == ("EC206", 16), finding.message


#: Success of one episode is success of all that follow.
WON = """
import gymnasium as gym
class Race(gym.Env):
    observation_space = gym.spaces.Discrete(200)
    action_space = gym.spaces.Discrete(2)
    won = False
    def _info(self):
        return {"is_success": self.won}
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.time = int(self.np_random.integers(5)), 0
        return self.at, self._info()
    def step(self, action):
        self.at, self.time = self.at + int(action), self.time + 1
        done = self.at >= 12 or self.time >= 20
        self.won = self.won or self.at >= 12
        return self.at, float(action), done, False, self._info()
"""

#: The list of the module grows with each reset, and the steps of the next episode raise.
CROWDED = """
import gymnasium as gym
OWLS = []
class Crowded(gym.Env):
    observation_space = gym.spaces.Discrete(1000)
    action_space = gym.spaces.Discrete(2)
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.owls = OWLS
        self.owls += [int(self.np_random.integers(5)) for _ in range(3)]
        self.time, self.flights = 0, [1, 1, 1]
        return sum(self.owls), {}
    def step(self, action):
        self.time += 1
        for number in range(len(self.owls)):
            self.flights[number] *= -1
        return sum(self.owls) + int(action), float(action), False, self.time >= 20, {}
"""


#: The fuel of one episode is what the episodes before it have left.
TANK = """
import gymnasium as gym
class Courier(gym.Env):
    observation_space = gym.spaces.Discrete(90)
    action_space = gym.spaces.Discrete(2)
    def __init__(self):
        self.fuel = 60
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.at, self.time = int(self.np_random.integers(30)), 0
        return self.at + self.fuel, {}
    def step(self, action):
        self.fuel, self.time = self.fuel - 1, self.time + 1
        return self.at + self.fuel, float(action), self.time >= 50, False, {}
"""


@pytest.mark.parametrize(("checks", "code"), [("api,determinism", "EC206"), ("api", "EC109")])
def test_an_observation_outside_its_space_after_earlier_episodes_follows_from_these(checks: str, code: str) -> None:
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick"}
    report = envcraft.validate(TANK, checks=checks, **options)
    assert [finding.code for check in report.reports[0].checks for finding in check.findings] == [code]


def test_traces_that_could_not_be_compared_are_undecided() -> None:
    options: Any = {"contract": "gymnasium", "sandbox": "process", "budget": "quick"}
    report = envcraft.validate(CROWDED, checks="determinism", **options)
    [check] = [check for check in report.reports[0].checks if check.check == "determinism"]
    assert check.undecided, check
    assert "IndexError" in check.reason
