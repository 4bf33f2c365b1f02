"""Judge subjects by checks, as a stream of events that reporters consume."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable, Collection, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import msgspec

from envcraft.errors import EnvCraftError, Skip, TargetLost, Undecided, UsageError
from envcraft.judging.budget import Budget
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, Limits, driver_for
from envcraft.judging.severity import SeverityPolicy
from envcraft.judging.subject import Subject, elapsed
from envcraft.judging.worker_pool import WorkerPool
from envcraft.judging.wrapped import with_wrappers_named
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
from envcraft.model.identity import fingerprint
from envcraft.model.target import Kind, PolicyFile, Project, Target
from envcraft.model.trace import Trace, digest_all
from envcraft.model.verdict import (
    CheckReport,
    Finding,
    ProjectFiles,
    Report,
    SandboxReport,
    Severity,
    SubjectReport,
    Verdict,
    overall,
)
from envcraft.text import relative

if TYPE_CHECKING:
    from envcraft.judging.ignore_comments import IgnoreComments

#: The time of a subject whose checks include one that runs only if it is named, in seconds.
_OPT_IN_SECONDS = 3600.0
#: Seconds between two events about one subject's steps.
_STEPS_EVERY = 0.25


class Plan(msgspec.Struct, frozen=True):
    """What to judge, and under which settings.

    Attributes:
        targets: the environments, in the order in which they are judged.
        contract: what they promise.
        driver: the sandbox.
        checks: in the order in which they run.
        budget: the numbers of episodes and steps.
        seed: of the run; all other seeds derive from it.
        policy: a file with a policy for the checks that use one.
        limits: of each job's memory and time.
        parallel_jobs: the number of jobs of one subject that run at a time. None divides the workers of the run by
            the number of subjects that are judged at a time. No verdict depends on it.
        time_limit: seconds on the clock for each subject; None takes the budget's, or an hour where a check runs that
            has to be named.
        fail_fast: a subject ends at its first finding that is an error.
        severity: which findings count, and how.
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
    time_limit: float | None = None
    fail_fast: bool = False
    severity: SeverityPolicy = SeverityPolicy()


def cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def validate(
    plan: Plan, workers: int | None = None, pool: WorkerPool | None = None, exitfirst: bool = False
) -> Generator[Event, None, None]:
    """Judge every target and yield the events of the run, the last of which is `Finished`.

    A sandbox that fails and a check that raises are ``error`` verdicts, not exceptions. Closing the iterator ends
    every worker that is still running, and so does an exception such as KeyboardInterrupt.

    Args:
        plan: what to judge.
        workers: the number of jobs that run at a time, by default the number of cores. Up to this number of subjects
            are judged at a time.
        pool: an open pool, whose first workers start before the call. It must have the plan's limits, its number of
            targets, and a driver that can read what the targets need (:func:`envcraft.judging.driver.driver_for`).
            It is closed at the end.
        exitfirst: the run ends with the first target that fails, in their order. No later one is in the report.
    """
    reports: dict[int, SubjectReport] = {}
    with contextlib.closing(stream(plan, workers, pool)) as running:
        for number, event in _until_failure(running) if exitfirst else running:
            if isinstance(event, SubjectFinished):
                reports[number] = event.report
            yield event
    ordered = [reports[number] for number in sorted(reports)]
    severity = plan.severity
    unjudged = len(plan.targets) - len(ordered) if exitfirst else 0
    report = Report(plan.contract.name, plan.seed, ordered, budget=plan.budget.name, unjudged=unjudged)
    yield Finished(msgspec.structs.replace(report, severity=severity.table, strict=severity.strict))


def _until_failure(events: Iterable[tuple[int, Event]]) -> Generator[tuple[int, Event], None, None]:
    """Yield events up to the first subject that fails; subjects end in their order, whichever is judged first."""
    ended: dict[int, SubjectFinished] = {}
    following = 1
    for number, event in events:
        if not isinstance(event, SubjectFinished):
            yield number, event
            continue
        ended[number] = event
        while (first := ended.pop(following, None)) is not None:
            yield following, first
            if first.report.verdict is Verdict.FAIL:
                return
            following += 1


def stream(
    plan: Plan, workers: int | None = None, pool: WorkerPool | None = None
) -> Generator[tuple[int, Event], None, None]:
    """Judge every target and yield each event with the number of its subject, counted from 1.

    Unlike :func:`validate`, it yields no `Finished` and keeps no reports. With a `pool`, the thread that judges a
    target takes it from `plan.targets` at that moment. If that raises TargetLost, the verdict is ``error``.

    Args:
        plan: what to judge.
        workers: as for :func:`validate`.
        pool: as for :func:`validate`.
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
        def emit(event: Event) -> None:
            events.put((number, event))

        try:
            target = plan.targets[number - 1]
        except TargetLost as lost:
            # The pool starts workers for the number of targets, and this one needs none.
            pool.lease().release()
            emit(SubjectStarted(lost.path, number, total))
            emit(SubjectFinished(not_judged(plan, lost.path, lost.env_class, lost.sha256, str(lost))))
            return
        emit(SubjectStarted(target.path, number, total))
        for event in judge(plan, target, pool, emit):
            emit(event)
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
            # The executor's exit waits for the threads, which end as soon as they have no workers.
            pool.close()


def judge(
    plan: Plan,
    target: Target,
    pool: WorkerPool,
    emit: Callable[[Event], None] | None = None,
    look: Callable[[Subject], None] | None = None,
) -> Generator[Event, None, None]:
    """Judge one target by all checks and yield the events.

    After a failed gate, and with `fail_fast` after any failure, only the checks that always run are run; the others
    are skipped.

    Args:
        plan: the settings.
        target: the environment.
        pool: provides its workers.
        emit: receives the events during a check, when the generator cannot yield.
        look: is called with the subject after its last check. Its rollouts count as steps of the report, but it
            cannot add findings.
    """
    started = time.monotonic()
    done: list[CheckReport] = []
    shown: set[str] = set()
    with open_subject(plan, target, pool) as subject:
        if emit is not None:
            subject.cache.on_steps = _throttled(target.path, emit)
        blocked = ""
        for check in plan.checks:
            if blocked and not check.always:
                report = CheckReport(check.name, Verdict.SKIP, reason=blocked)
            else:
                yield CheckStarted(target.path, check.name)
                report = run_check(check, subject, None, plan.fail_fast, plan.severity, shown)
            if plan.fail_fast and report.verdict is Verdict.FAIL:
                blocked = blocked or f"--fail-fast ends at the first error, and {check.name} has one"
            if (check.gate and report.verdict is Verdict.ERROR) or _stops(check, report):
                blocked = f"the check {check.name} did not pass"
            done.append(report)
            if len(done) == 3 and not blocked and report.verdict is not Verdict.SKIP:
                # Workers that start earlier would delay the first episodes. Where each job dies, none is needed.
                subject.lease.reserve(seed for later in plan.checks for seed in later.hash_seeds)
            yield CheckFinished(target.path, report)
        if not blocked:
            _conclude(plan, subject, done)
        if look is not None:
            look(subject)
        yield SubjectFinished(report_on(plan, subject, done, started))


def report_on(plan: Plan, subject: Subject, checks: list[CheckReport], started: float) -> SubjectReport:
    """Build the report on a subject.

    Args:
        plan: the settings.
        subject: the subject, still open.
        checks: the reports of its checks.
        started: the reading of ``time.monotonic`` when the subject was opened.
    """
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
        source_file=subject.source_file,
        kwargs=target.kwargs,
        wrappers=list(target.wrappers),
        project=_files_of(target.project) if target.project else None,
        traces=digest_all(subject.traces),
        fingerprint=subject.fingerprint,
        out_of_time=subject.time_limit.decided,
        fail_fast=plan.fail_fast and overall(checks) is Verdict.FAIL,
    )


def _files_of(project: Project) -> ProjectFiles:
    return ProjectFiles(relative(project.root), project.digests, list(project.imports))


def not_judged(plan: Plan, path: str, env_class: str | None, sha256: str, reason: str) -> SubjectReport:
    """Build the report on a target that no check judged, with the verdict ``error`` and this reason."""
    driver = plan.driver
    return SubjectReport(
        path, env_class, sha256, Verdict.ERROR, driver.isolation, 0.0, 0, [], driver=driver.name, reason=reason
    )


def _throttled(path: str, emit: Callable[[Event], None]) -> Callable[[int], None]:
    """Return a callback that emits a subject's steps, at most once every `_STEPS_EVERY` seconds."""
    last = time.monotonic()

    def stepped(steps: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= _STEPS_EVERY:
            last = now
            emit(StepsTaken(path, steps))

    return stepped


def open_subject(plan: Plan, target: Target, pool: WorkerPool | None = None) -> Subject:
    """Open the subject of a target, with workers from `pool`; None launches each worker when it is needed."""
    lease = (pool or WorkerPool(plan.driver, plan.limits)).lease()
    seconds = plan.time_limit
    subject = Subject(
        target, plan.contract, lease, plan.budget, plan.seed, plan.policy, plan.parallel_jobs or cores(), seconds
    )
    if plan.severity.comments and target.kind is Kind.SOURCE:
        subject.ignore_comments = _comments(target)
    if seconds is None and any(check.opt_in for check in plan.checks):
        subject.time_limit.seconds = max(subject.time_limit.seconds, _OPT_IN_SECONDS)
    return subject


def _comments(target: Target) -> IgnoreComments | None:
    """The comments of a file that ignore findings; None of one that cannot be read as text."""
    from envcraft.judging.ignore_comments import IgnoreComments

    try:
        return IgnoreComments(target.text)
    except UnicodeDecodeError:
        return None


def run_check(
    check: Check,
    subject: Subject,
    trace: Trace | None = None,
    fail_fast: bool = False,
    severity: SeverityPolicy = SeverityPolicy(),
    shown: set[str] | None = None,
) -> CheckReport:
    """Run one check and return its report.

    An exception of the check is this check's ``error``, not a failure of the subject.

    Args:
        check: the check.
        subject: the environment.
        trace: judge only this trace, instead of the rollouts that the check requests.
        fail_fast: stop at the first finding that is an error.
        severity: which findings count, and how.
        shown: the codes of the defects that earlier checks have shown, to which those of this check are added. The
            rules that they confirm report nothing.
    """
    started = time.monotonic()
    report = CheckReport(check.name, Verdict.PASS)
    shown = set() if shown is None else shown
    confirmed = {rule.code for rule in check.rules if not shown.isdisjoint(rule.confirmed_by)}
    try:
        judged = check.judge(subject) if trace is None else check.find(subject, trace)
        for finding in judged:
            if subject.target.wrappers:
                finding = with_wrappers_named(check, subject, finding)
            _take(report, check, subject, finding, severity, confirmed)
            if severity.shows(check, finding):
                shown.add(finding.code)
            if fail_fast and _failed(report):
                break
    except Skip as skip:
        report.verdict, report.reason, report.undecided = Verdict.SKIP, str(skip), isinstance(skip, Undecided)
    except EnvCraftError as error:
        report.verdict, report.reason = Verdict.ERROR, str(error)
        report.wrong_use = isinstance(error, UsageError)
    except Exception as error:
        report.verdict, report.reason = Verdict.ERROR, f"the check raised {type(error).__name__}: {error}"
    finally:
        subject.cache.cancel_pending()
    if report.verdict is not Verdict.ERROR and (_failed(report) or (severity.strict and report.undecided)):
        report.verdict = Verdict.FAIL
    report.seconds = elapsed(started)
    return report


def _take(
    report: CheckReport,
    check: Check,
    subject: Subject,
    finding: Finding,
    severity: SeverityPolicy,
    without: Collection[str] = (),
) -> None:
    """Add a finding to a report, unless the contract, the severities or a comment leave it out.

    An error of a policy for many environments leaves the check undecided.

    Raises:
        UsageError: the finding is an error of the policy that an author named.
    """
    ignored = None
    if subject.ignore_comments is not None and check.waivable(finding.code):
        # Also what is left out for another reason: the comment is not unused.
        ignored = subject.ignore_comments.take(finding)
    if finding.code in subject.contract.without or finding.code in without:
        return
    if (counted := severity.apply(check, finding)) is None:
        return
    policy = subject.policy
    if policy is not None and counted.severity is Severity.ERROR and check.rule(counted.code).about_policy:
        if policy.common:
            report.verdict, report.undecided = Verdict.SKIP, True
            report.reason = f"the policy cannot play this environment: {finding.message}"
            return
        if severity.comments:
            raise UsageError(f"--policy: {finding.message}", setting="policy")
    if ignored is not None:
        report.ignored.append(msgspec.structs.replace(ignored, finding=counted))
    elif check.waivable(finding.code) and _known(report, subject.target.path, finding.code, severity.baseline):
        report.known.append(counted)
    elif counted not in report.findings:
        report.findings.append(counted)


def _known(report: CheckReport, path: str, code: str, baseline: Collection[str]) -> bool:
    """Whether the next finding of a code is in a baseline."""
    if not baseline:
        return False
    nth = sum(finding.code == code for finding in [*report.known, *report.findings])
    return fingerprint(path, code, nth) in baseline


def _failed(report: CheckReport) -> bool:
    return any(finding.severity is Severity.ERROR for finding in report.findings)


def _stops(check: Check, report: CheckReport) -> bool:
    """Whether a check has a finding after which nothing else can be judged."""
    return any(check.stops(finding.code) for finding in report.findings)


def _conclude(plan: Plan, subject: Subject, reports: list[CheckReport]) -> None:
    """Add the findings that only all reports together show."""
    # The check source, which stands first, knows only after all others which comments ignore nothing.
    for check, report in reversed([*zip(plan.checks, reports, strict=True)]):
        try:
            for finding in check.conclude(subject, reports):
                _take(report, check, subject, finding, plan.severity)
        except Exception as error:
            report.verdict, report.reason = Verdict.ERROR, f"the check raised {type(error).__name__}: {error}"
        if report.verdict is not Verdict.ERROR and _failed(report):
            report.verdict = Verdict.FAIL
