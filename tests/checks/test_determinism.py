"""Which differences the check determinism reports, on traces that depend on the conditions in a known way."""

from __future__ import annotations

from typing import Any

import pytest
from envcraft_checks.determinism import Determinism

from envcraft.judging.budget import BUDGETS
from envcraft.model.rollout import ClockShift, Conditions, Episode, Rollout
from envcraft.model.target import Kind, Target
from envcraft.model.trace import Trace

CLOCK, BEFORE = Conditions(clock=ClockShift(1.0, 2.0)), Conditions(before=[Episode(1, [])])
ALL = Conditions(clock=CLOCK.clock, before=BEFORE.before)


class Played:
    """A subject whose first observation tells the conditions that it depends on."""

    target = Target("Walk-v0", kind=Kind.ID)
    installed_source = b""
    budget = BUDGETS["quick"]

    def __init__(self, *causes: str) -> None:
        self._causes = causes

    def rollout(self, rollout: Rollout, alone: bool = False) -> Trace:
        changed = [cause for cause in self._causes if getattr(rollout.conditions, cause)]
        return Trace(rollout, observations=[b"%d" % bool(changed)], infos=[b"{}"])

    rerun = rollout

    def prefetch(self, *_: Any, **__: Any) -> None: ...

    def affords(self, steps: int) -> bool:
        return True

    def line_of(self, method: str) -> int | None:
        return None


@pytest.mark.parametrize(
    ("causes", "codes"), [(("clock", "before"), ["EC205"]), (("before",), ["EC206"]), (("clock",), ["EC205"]), ((), [])]
)
def test_an_episode_that_depends_on_the_clock_has_no_other_cause(
    causes: tuple[str, ...], codes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    check = Determinism()
    alone = [("EC205", CLOCK, "clock"), ("EC206", BEFORE, "before")]
    monkeypatch.setattr("envcraft_checks.comparing.conditions.alone", lambda subject, rollout: alone)
    monkeypatch.setattr("envcraft_checks.comparing.conditions.together", lambda subject, rollout, left_out: ALL)
    monkeypatch.setattr("envcraft_checks.comparing.causes.reset_again", lambda subject, rollout, info: None)
    subject: Any = Played(*causes)
    assert [finding.code for finding in check._compare(subject, Rollout(0, []), True)] == codes
