"""Judge subjects by checks, as a stream of events that reporters consume."""

from __future__ import annotations

import queue
import threading
import time
import weakref
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import msgspec

from envcraft.budget import Budget
from envcraft.check import Check, Skip
from envcraft.contract import Contract
from envcraft.errors import EnvCraftError, WorkerLost
from envcraft.events import CheckFinished, CheckStarted, Event, Finished, SubjectFinished, SubjectStarted
from envcraft.sandbox import Availability, Driver, Limits, Worker
from envcraft.subject import PolicyFile, Subject, Target, elapsed
from envcraft.verdict import CheckReport, Finding, Report, Severity, SubjectReport, Verdict, overall


class Plan(msgspec.Struct, frozen=True):
    """What to judge, and how."""

    targets: Sequence[Target]
    contract: Contract
    driver: Driver
    checks: Sequence[Check]
    budget: Budget
    seed: int = 0
    policy: PolicyFile | None = None
    limits: Limits = Limits()


def validate(plan: Plan, workers: int = 1) -> Generator[Event, None, None]:
    """Judge every target, up to `workers` side by side. A sandbox that fails or a check that breaks is an ``error``.

    Closing the iterator, or an exception such as KeyboardInterrupt, ends every worker that is still running.
    """
    reports: dict[int, SubjectReport] = {}
    with Leash(plan.driver) as leash:
        plan = msgspec.structs.replace(plan, driver=leash)
        for number, event in _in_turn(plan) if workers <= 1 else _side_by_side(plan, workers, leash):
            if isinstance(event, SubjectFinished):
                reports[number] = event.report
            yield event
    ordered = [reports[number] for number in sorted(reports)]
    yield Finished(Report(plan.contract.name, plan.seed, ordered, budget=plan.budget.name))


def _in_turn(plan: Plan) -> Iterator[tuple[int, Event]]:
    for number, target in enumerate(plan.targets, 1):
        yield number, SubjectStarted(target.path, number, len(plan.targets))
        for event in judge(plan, target):
            yield number, event


def _side_by_side(plan: Plan, workers: int, leash: Leash) -> Iterator[tuple[int, Event]]:
    events: queue.SimpleQueue[tuple[int, Event] | BaseException | None] = queue.SimpleQueue()

    def run(number: int, target: Target) -> None:
        try:
            if not leash.ended:
                events.put((number, SubjectStarted(target.path, number, len(plan.targets))))
                for event in judge(plan, target):
                    events.put((number, event))
                    if leash.ended:
                        break
        except BaseException as error:
            events.put(error)
        finally:
            events.put(None)

    with ThreadPoolExecutor(workers, "envcraft-judge") as pool:
        try:
            for number, target in enumerate(plan.targets, 1):
                pool.submit(run, number, target)
            running = len(plan.targets)
            while running:
                event = events.get()
                if event is None:
                    running -= 1
                elif isinstance(event, BaseException):
                    raise event
                else:
                    yield event
        finally:
            # Leaving the pool waits for its threads: without workers they have nothing left to do.
            leash.end()


class Leash(Driver):
    """A driver that remembers its workers, so that one call ends them all, whichever thread they serve."""

    def __init__(self, driver: Driver) -> None:
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self.ended = False
        self._driver = driver
        self._workers: weakref.WeakSet[Worker] = weakref.WeakSet()
        self._lock = threading.Lock()

    def __enter__(self) -> Leash:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        if self.ended:
            raise WorkerLost("the validation was ended")
        worker = self._driver.launch(hash_seed=hash_seed, limits=limits)
        with self._lock:
            self._workers.add(worker)
        if self.ended:
            worker.close()
            raise WorkerLost("the validation was ended")
        return worker

    def end(self) -> None:
        """Close every worker and launch no more."""
        self.ended = True
        with self._lock:
            workers = list(self._workers)
        for worker in workers:
            worker.close()


def judge(plan: Plan, target: Target) -> Iterator[Event]:
    """Judge one target by all checks. Once ``source`` fails there is nothing that the others could run."""
    started = time.monotonic()
    done: list[CheckReport] = []
    with open_subject(plan, target) as subject:
        blocked = ""
        for check in plan.checks:
            if blocked and not check.always:
                report = CheckReport(check.name, Verdict.SKIP, reason=blocked)
            else:
                yield CheckStarted(target.path, check.name)
                report = run_check(check, subject)
            if check.name == "source" and report.verdict in (Verdict.FAIL, Verdict.ERROR):
                blocked = "the file did not get past the check source"
            done.append(report)
            yield CheckFinished(target.path, report)
        verdict = overall(done)
        reason = next((report.reason for report in done if report.verdict is Verdict.ERROR), "")
        yield SubjectFinished(
            SubjectReport(
                path=target.path,
                env_class=subject.env_class,
                source_sha256=target.sha256,
                verdict=verdict,
                isolation=plan.driver.isolation,
                seconds=elapsed(started),
                steps=subject.steps,
                checks=done,
                driver=plan.driver.name,
                reason=reason,
                policy=plan.policy.path if plan.policy else None,
            )
        )


def open_subject(plan: Plan, target: Target) -> Subject:
    """The subject of a target under a plan."""
    return Subject(target, plan.contract, plan.driver, plan.budget, plan.seed, plan.policy, plan.limits)


def run_check(check: Check, subject: Subject) -> CheckReport:
    """Run one check guarded: an exception of its own is this check's error, not the subject's failure."""
    started = time.monotonic()
    findings: list[Finding] = []
    try:
        findings.extend(check.judge(subject))
        failed = any(finding.severity is Severity.ERROR for finding in findings)
        verdict, reason = Verdict.FAIL if failed else Verdict.PASS, ""
    except Skip as skip:
        failed = any(finding.severity is Severity.ERROR for finding in findings)
        verdict, reason = Verdict.FAIL if failed else Verdict.SKIP, str(skip)
    except EnvCraftError as error:
        verdict, reason = Verdict.ERROR, str(error)
    except Exception as error:
        verdict, reason = Verdict.ERROR, f"the check broke: {type(error).__name__}: {error}"
    return CheckReport(check.name, verdict, elapsed(started), findings, reason)
