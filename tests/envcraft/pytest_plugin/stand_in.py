"""What the tests of the pytest plugin share: an engine with given reports, and how pytest is run."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.engine import Plan
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import CheckReport, Finding, Report, Repro, Severity, SubjectReport, Verdict, overall

QUICK = ("--envcraft", "--envcraft-sandbox=process", "--envcraft-budget=quick", "-p", "no:cacheprovider")
#: Would end the whole run where something imported it.
TRAP = "import sys\nsys.exit('imported')\nimport gymnasium\nclass Trap(gymnasium.Env):\n    pass\n"


class Canned:
    """In place of the engine: the reports that are given for each check, else a pass; and what it was asked."""

    def __init__(self) -> None:
        self.plans: list[Plan] = []
        self.reports: dict[str, CheckReport] = {}

    def set(self, check: str, verdict: Verdict, *findings: Finding, reason: str = "", undecided: bool = False) -> None:
        self.reports[check] = CheckReport(check, verdict, 1.25, list(findings), reason, undecided)

    def validate(self, plan: Plan, workers: int | None = None) -> Iterator[Finished]:
        self.plans.append(plan)
        [target] = plan.targets
        checks = [self.reports.get(check.name, CheckReport(check.name, Verdict.PASS)) for check in plan.checks]
        report = SubjectReport(
            target.path, "Walk", target.sha256, overall(checks), "process", 1.0, 42, checks, plan.driver.name
        )
        yield Finished(Report(plan.contract.name, plan.seed, [report]))

    @property
    def target(self) -> Target:
        return self.plans[-1].targets[0]


class NoDriver(Driver):
    """Is asked for nothing."""

    name, isolation = "process", Isolation.PROCESS

    def probe(self) -> Availability:
        raise AssertionError

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        raise AssertionError


def failing(code: str, message: str, line: int | None = None) -> Finding:
    return Finding(code, Severity.ERROR, message, line, repro=Repro(7, [[0, 0, 0]] * 41, {"hash_seed": 1}))


Run = Callable[..., pytest.RunResult]


def outcomes(result: pytest.RunResult) -> dict[str, str]:
    """The outcome of each test that ``-v`` told."""
    words = [line.split() for line in result.outlines if "::" in line and "%]" in line]
    return {word[0]: word[1] for word in words}
