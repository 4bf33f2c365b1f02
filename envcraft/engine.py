"""Judge subjects by checks, as a stream of events that reporters consume."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence

import msgspec

from envcraft.budget import Budget
from envcraft.check import Check, Skip
from envcraft.contract import Contract
from envcraft.errors import EnvCraftError
from envcraft.sandbox import Driver, Limits
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


class SubjectStarted(msgspec.Struct, frozen=True):
    """A subject's turn: `number` of `total`."""

    path: str
    number: int
    total: int


class CheckStarted(msgspec.Struct, frozen=True):
    path: str
    check: str


class CheckFinished(msgspec.Struct, frozen=True):
    path: str
    report: CheckReport


class SubjectFinished(msgspec.Struct, frozen=True):
    report: SubjectReport


class Finished(msgspec.Struct, frozen=True):
    """The last event."""

    report: Report


Event = SubjectStarted | CheckStarted | CheckFinished | SubjectFinished | Finished


def validate(plan: Plan) -> Iterator[Event]:
    """Judge every target in turn. A sandbox that fails or a check that breaks is an ``error``, and the rest go on."""
    reports = []
    for number, target in enumerate(plan.targets, 1):
        yield SubjectStarted(target.path, number, len(plan.targets))
        for event in judge(plan, target):
            if isinstance(event, SubjectFinished):
                reports.append(event.report)
            yield event
    yield Finished(Report(plan.contract.name, plan.seed, reports, budget=plan.budget.name))


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
