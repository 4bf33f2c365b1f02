"""Judging: what a check that breaks, a sandbox that fails and several workers mean for the report."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from envcraft_protocol.jobs import Job

from envcraft.contracts.builtin import ARCADE
from envcraft.errors import Skip, WorkerLost
from envcraft.judging import engine
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check, Rule
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Player, Recorder, Worker
from envcraft.judging.engine import Plan, validate
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import CheckStarted, Event, Finished, StepsTaken, SubjectFinished
from envcraft.model.job import JobResult
from envcraft.model.rollout import Rollout
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, Report, Severity, Verdict


class StubWorker(Worker):
    def __init__(self) -> None:
        self.about = {}
        self.closed = 0

    def preload(self, modules: list[str]) -> list[str]:
        return modules

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        return [], []

    def run(self, job: Job, recorder: Recorder, limits: Limits, player: Player | None = None) -> JobResult:
        raise WorkerLost("the worker is gone")

    def close(self) -> None:
        self.closed += 1


class StubDriver(Driver):
    name = "stub"
    isolation = Isolation.PROCESS
    rank = 1

    def __init__(self) -> None:
        self.workers: list[StubWorker] = []

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        self.workers.append(StubWorker())
        return self.workers[-1]


class StubCheck(Check):
    rules = (Rule("EC901", "a", "A.", "Mend."), Rule("EC902", "b", "B.", "Mend.", Severity.WARNING))

    def __init__(self, name: str, *outcomes: str | Exception, always: bool = False, gate: bool = False) -> None:
        self.name, self.outcomes, self.always, self.gate = name, outcomes, always, gate

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for outcome in self.outcomes:
            if isinstance(outcome, Exception):
                raise outcome
            if outcome == "launch":
                subject.find_modules([])
            else:
                yield self.finding(outcome, "wrong")


def judged(*checks: Check, driver: Driver | None = None, targets: int = 1, workers: int = 1) -> Report:
    files = [Target(f"{number}.py", b"") for number in range(targets)]
    events = list(validate(Plan(files, ARCADE, driver or StubDriver(), checks, BUDGETS["quick"]), workers))
    assert isinstance(events[-1], Finished)
    return events[-1].report


@pytest.mark.parametrize(
    ("outcomes", "verdict", "reason"),
    [
        ((), "pass", ""),
        (("EC902",), "pass", ""),
        (("EC901",), "fail", ""),
        ((Skip("cannot tell"),), "skip", "cannot tell"),
        (("EC901", Skip("no more")), "fail", "no more"),
        ((ValueError("oops"),), "error", "the check raised ValueError: oops"),
        ((WorkerLost("gone"),), "error", "gone"),
    ],
)
def test_verdict_of_a_check(outcomes: tuple[Any, ...], verdict: str, reason: str) -> None:
    (subject,) = judged(StubCheck("one", *outcomes)).reports
    (check,) = subject.checks
    assert (check.verdict, check.reason) == (verdict, reason)


def test_a_broken_check_leaves_the_others_their_verdicts() -> None:
    (subject,) = judged(StubCheck("one", ValueError("oops")), StubCheck("two", "EC901"), StubCheck("three")).reports
    assert [check.verdict for check in subject.checks] == ["error", "fail", "pass"]
    assert subject.verdict is Verdict.FAIL


def test_after_a_failed_gate_only_checks_that_always_run_are_run() -> None:
    checks = [StubCheck("one", "EC901"), StubCheck("two", "EC901", gate=True), StubCheck("three", "EC901")]
    (subject,) = judged(*checks, StubCheck("last", always=True)).reports
    assert [check.verdict for check in subject.checks] == ["fail", "fail", "skip", "pass"]
    assert subject.checks[2].reason == "the check two did not pass"


@pytest.mark.parametrize("workers", [1, 4])
def test_exitfirst_ends_the_run_with_the_first_target_that_fails(workers: int) -> None:
    later = threading.Event()

    class Waiting(StubCheck):
        def judge(self, subject: Subject) -> Iterator[Finding]:
            # With several workers, the second failure comes before the first.
            if subject.target.path == "d":
                later.set()
            elif workers > 1:
                later.wait(10)
            if subject.target.path in "bd":
                yield self.finding("EC901", "it fails")

    targets = [Target(name, b"") for name in "abcd"]
    plan = Plan(targets, ARCADE, StubDriver(), [Waiting("one", "EC901")], BUDGETS["quick"])
    *events, last = validate(plan, workers, exitfirst=True)
    assert isinstance(last, Finished)
    assert [event.report.path for event in events if isinstance(event, SubjectFinished)] == ["a", "b"]
    assert ([report.path for report in last.report.reports], last.report.unjudged) == (["a", "b"], 2)


def test_fail_fast_ends_a_subject_at_its_first_error() -> None:
    checks = [StubCheck("one", "EC902"), StubCheck("two", "EC901", "EC902"), StubCheck("three", "EC901")]
    targets = [Target("a.py", b"")]
    plan = Plan(targets, ARCADE, StubDriver(), [*checks, StubCheck("last", always=True)], BUDGETS["quick"])
    for fail_fast, verdicts in ((False, ["pass", "fail", "fail", "pass"]), (True, ["pass", "fail", "skip", "pass"])):
        *_, last = validate(msgspec.structs.replace(plan, fail_fast=fail_fast))
        assert isinstance(last, Finished)
        (subject,) = last.report.reports
        assert [check.verdict for check in subject.checks] == verdicts
        assert len(subject.checks[1].findings) == 2 - fail_fast
        assert subject.fail_fast == fail_fast
        assert subject.verdict is Verdict.FAIL
    assert subject.checks[2].reason == "--fail-fast ends at the first error, and two has one"


def test_what_the_clock_leaves_open_is_skipped_and_the_report_says_so() -> None:
    class Slow(StubCheck):
        def judge(self, subject: Subject) -> Iterator[Finding]:
            yield from super().judge(subject)
            subject.time_limit.seconds = 0
            subject.rollout(Rollout(0, []))

    (subject,) = judged(Slow("slow", "EC902"), StubCheck("quick", "EC902")).reports
    assert [check.verdict for check in subject.checks] == ["skip", "pass"]
    assert subject.checks[0].reason.startswith("out of time: the limit of ")
    assert (subject.out_of_time, subject.verdict) == (True, "pass")
    assert [len(check.findings) for check in subject.checks] == [1, 1]
    (subject,) = judged(StubCheck("quick")).reports
    assert not subject.out_of_time


@pytest.mark.parametrize(("named", "opt_in", "seconds"), [(None, False, 120), (7.5, False, 7.5), (None, True, 3600)])
def test_the_time_limit_of_a_subject(named: float | None, opt_in: bool, seconds: float) -> None:
    check = StubCheck("one")
    check.opt_in = opt_in
    plan = Plan([Target("a.py", b"")], ARCADE, StubDriver(), [check], BUDGETS["quick"], time_limit=named)
    with engine.open_subject(plan, plan.targets[0]) as subject:
        assert subject.time_limit.seconds == seconds
        assert seconds - 5 < subject.time_limit.left <= seconds


@pytest.mark.parametrize("workers", [1, 3])
def test_reports_are_in_the_order_of_the_targets_and_every_worker_is_closed(workers: int) -> None:
    driver = StubDriver()
    report = judged(StubCheck("one", "launch"), driver=driver, targets=7, workers=workers)
    assert [subject.path for subject in report.reports] == [f"{number}.py" for number in range(7)]
    assert len(driver.workers) == 7
    assert all(worker.closed for worker in driver.workers)


def test_subjects_are_judged_side_by_side() -> None:
    barrier = threading.Barrier(3, timeout=120)

    class Meet(StubCheck):
        def judge(self, subject: Subject) -> Iterator[Finding]:
            barrier.wait()
            yield from ()

    report = judged(Meet("meet"), targets=3, workers=3)
    assert [subject.verdict for subject in report.reports] == ["pass"] * 3


@pytest.mark.parametrize("workers", [1, 2])
def test_closing_the_events_ends_every_worker(workers: int) -> None:
    driver = StubDriver()
    plan = Plan(
        [Target(f"{n}.py", b"") for n in range(50)], ARCADE, driver, [StubCheck("one", "launch")], BUDGETS["quick"]
    )
    events = validate(plan, workers)
    first: Event = next(event for event in events if isinstance(event, SubjectFinished))
    events.close()
    assert first
    assert 1 <= len(driver.workers) < 50
    assert all(worker.closed for worker in driver.workers)


def path_of(event: Event) -> str:
    """The path of the event's subject; "" for the event at the end."""
    if isinstance(event, SubjectFinished):
        return event.report.path
    return "" if isinstance(event, Finished) else event.path


def test_events_of_one_subject_stay_in_order_and_every_subject_gets_its_own() -> None:
    files = [Target(f"{n}.py", b"") for n in range(12)]
    checks = [StubCheck("one", "launch"), StubCheck("two", "EC902")]
    seen: dict[str, list[str]] = {}
    for event in validate(Plan(files, ARCADE, StubDriver(), checks, BUDGETS["quick"]), 4):
        seen.setdefault(path_of(event), []).append(type(event).__name__)
    order = ["SubjectStarted", *["CheckStarted", "CheckFinished"] * 2, "SubjectFinished"]
    assert seen == {"": ["Finished"], **{file.path: order for file in files}}


@pytest.mark.parametrize("every", [0.0, 60.0])
@pytest.mark.parametrize("workers", [1, 2])
def test_step_events_within_a_check_are_throttled(monkeypatch: pytest.MonkeyPatch, workers: int, every: float) -> None:
    class Stepping(StubCheck):
        def judge(self, subject: Subject) -> Iterator[Finding]:
            assert subject.cache.on_steps is not None
            for steps in (100, 200):
                subject.cache.on_steps(steps)
            yield from ()

    monkeypatch.setattr("envcraft.judging.engine._STEPS_EVERY", every)
    files = [Target(f"{n}.py", b"") for n in range(2)]
    plan = Plan(files, ARCADE, StubDriver(), [Stepping("one")], BUDGETS["quick"])
    seen: list[Event] = [event for event in validate(plan, workers) if path_of(event) == "1.py"]
    told = [StepsTaken("1.py", steps) for steps in (100, 200)] if not every else []
    assert seen[1:-2] == [CheckStarted("1.py", "one"), *told]


@pytest.mark.parametrize(
    ("workers", "targets", "parallel_jobs"),
    [(None, 1, 6), (None, 2, 3), (4, 9, 1), (None, 50, 1), (2, 9, 1), (4, 2, 2), (1, 1, 1)],
)
def test_subjects_share_the_cores(
    monkeypatch: pytest.MonkeyPatch, workers: int | None, targets: int, parallel_jobs: int
) -> None:
    monkeypatch.setattr("envcraft.judging.engine.cores", lambda: 6)
    given: list[int | None] = []
    opened = engine.open_subject

    def spy(plan: Plan, target: Target, pool: WorkerPool) -> Subject:
        given.append(plan.parallel_jobs)
        return opened(plan, target, pool)

    monkeypatch.setattr("envcraft.judging.engine.open_subject", spy)
    files = [Target(f"{n}.py", b"") for n in range(targets)]
    assert list(validate(Plan(files, ARCADE, StubDriver(), [StubCheck("one")], BUDGETS["quick"]), workers))
    assert given == [parallel_jobs] * targets


class Repeats(Check):
    name = "repeats"
    rules = (Rule("EC999", "repeats", "A.", "Mend."),)

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for message in ("one", "one", "two"):
            yield self.finding("EC999", message, line=3)


def test_identical_findings_are_reported_once() -> None:
    *_, last = validate(Plan([Target("a.py")], ARCADE, StubDriver(), [Repeats()], BUDGETS["quick"]))
    assert isinstance(last, Finished)
    (check,) = last.report.reports[0].checks
    assert [finding.message for finding in check.findings] == ["one", "two"]
