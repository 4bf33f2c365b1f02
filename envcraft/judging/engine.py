"""Judge subjects by checks, as a stream of events that reporters consume."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor

import msgspec

from envcraft.errors import EnvCraftError, Skip, TargetLost
from envcraft.judging.budget import Budget
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, Limits, driver_for
from envcraft.judging.subject import Subject, elapsed
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.contract import Contract
from envcraft.model.events import (
    CheckFinished,
    CheckStarted,
    Event,
    Finished,
    StepsTaken,
    SubjectFinished,
    SubjectStarted,
)
from envcraft.model.target import PolicyFile, Target
from envcraft.model.trace import Trace, digest_all
from envcraft.model.verdict import (
    CheckReport,
    Finding,
    Report,
    SandboxReport,
    Severity,
    SubjectReport,
    Verdict,
    overall,
)

#: Seconds between two events about one subject's steps.
_STEPS_EVERY = 0.25


class Plan(msgspec.Struct, frozen=True):
    """What to judge, and under which settings.

    `parallel_jobs` is the number of jobs of one subject that run at a time. None divides the workers of the run by
    the number of subjects that are judged at a time. No verdict depends on it.
    """

    targets: Sequence[Target]
    contract: Contract
    driver: Driver
    checks: Sequence[Check]
    budget: Budget
    seed: int = 0
    policy: PolicyFile | None = None
    limits: Limits = Limits()
    parallel_jobs: int | None = None


def cores() -> int:
    """The number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def validate(plan: Plan, workers: int | None = None, pool: WorkerPool | None = None) -> Generator[Event, None, None]:
    """Judge every target, with up to `workers` jobs side by side: by default as many as there are cores. They are those
    of as many subjects, or of fewer if there are no more.

    `pool` may have been opened before, with the plan's driver (which must see what the targets need,
    :func:`envcraft.judging.driver.driver_for`), limits and number of targets, so that the first workers are under
    way; it is ended here. A sandbox that fails or a check that breaks is an ``error``. Closing the iterator,
    or an exception such as KeyboardInterrupt, ends every worker that is still running.
    """
    reports: dict[int, SubjectReport] = {}
    with contextlib.closing(stream(plan, workers, pool)) as running:
        for number, event in running:
            if isinstance(event, SubjectFinished):
                reports[number] = event.report
            yield event
    ordered = [reports[number] for number in sorted(reports)]
    yield Finished(Report(plan.contract.name, plan.seed, ordered, budget=plan.budget.name))


def stream(
    plan: Plan, workers: int | None = None, pool: WorkerPool | None = None
) -> Generator[tuple[int, Event], None, None]:
    """As :func:`validate`, but without the last event, so that no report is kept: each event comes with the number of
    its subject. With a `pool`, a target is taken from `plan.targets` when its turn comes, by the thread that judges it;
    one that raises TargetLost then is an ``error``.
    """
    jobs = workers or cores()
    workers = max(min(jobs, len(plan.targets)), 1)
    driver = driver_for(plan.driver, plan.targets) if pool is None else plan.driver
    plan = msgspec.structs.replace(plan, driver=driver, parallel_jobs=plan.parallel_jobs or max(jobs // workers, 1))
    with (
        pool or WorkerPool(plan.driver, plan.limits, len(plan.targets)) as pool,
        contextlib.closing(_side_by_side(plan, pool, workers)) as running,
    ):
        yield from running


def _side_by_side(plan: Plan, pool: WorkerPool, workers: int) -> Generator[tuple[int, Event], None, None]:
    events: queue.SimpleQueue[tuple[int, Event] | BaseException | None] = queue.SimpleQueue()
    total = len(plan.targets)
    turns, turn = iter(range(1, total + 1)), threading.Lock()

    def run(number: int) -> None:
        def tell(event: Event) -> None:
            events.put((number, event))

        try:
            target = plan.targets[number - 1]
        except TargetLost as lost:
            # It needs no worker.
            pool.lease().release()
            tell(SubjectStarted(lost.path, number, total))
            tell(SubjectFinished(not_judged(plan, lost.path, lost.env_class, lost.sha256, str(lost))))
            return
        tell(SubjectStarted(target.path, number, total))
        for event in judge(plan, target, pool, tell):
            tell(event)
            if pool.closed:
                break

    def work() -> None:
        try:
            while not pool.closed:
                with turn:
                    number = next(turns, None)
                if number is None:
                    break
                run(number)
        except BaseException as error:
            events.put(error)
        finally:
            events.put(None)

    with ThreadPoolExecutor(workers, "envcraft-judge") as threads:
        try:
            for _ in range(workers):
                threads.submit(work)
            running = workers
            while running:
                event = events.get()
                if event is None:
                    running -= 1
                elif isinstance(event, BaseException):
                    raise event
                else:
                    yield event
        finally:
            # Leaving waits for the threads: without workers they have nothing left to do.
            pool.close()


def judge(
    plan: Plan,
    target: Target,
    pool: WorkerPool,
    tell: Callable[[Event], None] | None = None,
    look: Callable[[Subject], None] | None = None,
) -> Generator[Event, None, None]:
    """Judge one target by all checks. Those after a failed gate are skipped, except the ones that always run.

    `tell` gets what happens within a check, while the generator cannot yield. `look` is shown the subject once its
    checks are done: what it asks for is in the report's steps, and no finding.
    """
    started = time.monotonic()
    done: list[CheckReport] = []
    with open_subject(plan, target, pool) as subject:
        if tell is not None:
            subject.cache.on_steps = _now_and_then(target.path, tell)
        blocked = ""
        for check in plan.checks:
            if blocked and not check.always:
                report = CheckReport(check.name, Verdict.SKIP, reason=blocked)
            else:
                yield CheckStarted(target.path, check.name)
                report = run_check(check, subject)
            if check.gate and report.verdict in (Verdict.FAIL, Verdict.ERROR):
                blocked = f"it did not get past the check {check.name}"
            done.append(report)
            if len(done) == 2 and not blocked:
                # Not sooner: workers that start would hold up the first episodes.
                subject.lease.reserve(seed for later in plan.checks for seed in later.hash_seeds)
            yield CheckFinished(target.path, report)
        if look is not None:
            look(subject)
        yield SubjectFinished(report_on(plan, subject, done, started))


def report_on(plan: Plan, subject: Subject, checks: list[CheckReport], started: float) -> SubjectReport:
    """The report of a subject that was opened at `started`, a reading of ``time.monotonic``."""
    target, available = subject.target, plan.driver.availability
    return SubjectReport(
        path=target.path,
        env_class=subject.env_class,
        source_sha256=subject.source_sha256,
        verdict=overall(checks),
        isolation=plan.driver.isolation,
        seconds=elapsed(started),
        steps=subject.steps,
        checks=checks,
        driver=plan.driver.name,
        reason=next((report.reason for report in checks if report.verdict is Verdict.ERROR), ""),
        policy=plan.policy.path if plan.policy else None,
        sandbox=SandboxReport.of(plan.driver.name, available.layers, available.missing, subject.about),
        kind=target.kind,
        module=subject.module,
        kwargs=target.kwargs,
        wrappers=list(target.wrappers),
        traces=digest_all(subject.traces),
        fingerprint=subject.fingerprint,
    )


def not_judged(plan: Plan, path: str, env_class: str | None, sha256: str, reason: str) -> SubjectReport:
    """The report on a target that no check has judged."""
    driver = plan.driver
    return SubjectReport(
        path, env_class, sha256, Verdict.ERROR, driver.isolation, 0.0, 0, [], driver=driver.name, reason=reason
    )


def _now_and_then(path: str, tell: Callable[[Event], None]) -> Callable[[int], None]:
    """Give a callback that reports a subject's steps, at most a few times a second."""
    last = time.monotonic()

    def stepped(steps: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _STEPS_EVERY:
            last = now
            tell(StepsTaken(path, steps))

    return stepped


def open_subject(plan: Plan, target: Target, pool: WorkerPool | None = None) -> Subject:
    """The subject of a target under a plan, with workers from `pool`; None launches each when it is needed."""
    lease = (pool or WorkerPool(plan.driver, plan.limits)).lease()
    return Subject(target, plan.contract, lease, plan.budget, plan.seed, plan.policy, plan.parallel_jobs or cores())


def run_check(check: Check, subject: Subject, trace: Trace | None = None) -> CheckReport:
    """Run one check guarded, on `trace` alone if there is one: an exception of its own is this check's error, not the
    subject's failure.
    """
    started = time.monotonic()
    findings: list[Finding] = []
    try:
        judged = check.judge(subject) if trace is None else check.find(subject, trace)
        findings.extend(found for found in judged if found.code not in subject.contract.without)
        failed = any(finding.severity is Severity.ERROR for finding in findings)
        verdict, reason = Verdict.FAIL if failed else Verdict.PASS, ""
    except Skip as skip:
        failed = any(finding.severity is Severity.ERROR for finding in findings)
        verdict, reason = Verdict.FAIL if failed else Verdict.SKIP, str(skip)
    except EnvCraftError as error:
        verdict, reason = Verdict.ERROR, str(error)
    except Exception as error:
        verdict, reason = Verdict.ERROR, f"the check broke: {type(error).__name__}: {error}"
    finally:
        subject.cache.cancel_pending()
    return CheckReport(check.name, verdict, elapsed(started), findings, reason)
