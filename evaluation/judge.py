"""Judge many environments with one pool of workers, each by a plan of its own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, Limits
from envcraft.judging.engine import Plan, cores, judge
from envcraft.judging.selection import default_checks, driver_named
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import SubjectFinished
from envcraft.model.target import read_policy, read_target
from envcraft.model.verdict import Severity, SubjectReport
from evaluation.fixtures import Fixture

#: Some files never finish their import, and nothing here takes seconds to import.
LIMITS = Limits(loading=10.0)


def judge_fixtures(
    fixtures: Sequence[Fixture], sandbox: str = "auto", narrow: bool = False, budget: str = "standard"
) -> Iterator[tuple[Fixture, SubjectReport]]:
    """Yield each fixture with its report, in the order in which they finish.

    All checks judge every fixture at one budget. With `narrow` all checks judge the good fixtures at `quick`, and only
    the checks of the expected codes judge the bad ones: at `quick`, and at `standard` if `quick` does not find the
    codes. Most of the time is spent on defects that do not exist.
    """
    every, driver = default_checks(), driver_named(sandbox)

    def judge_at(budget: str, chosen: Sequence[Fixture]) -> Iterator[tuple[Fixture, SubjectReport]]:
        plans = [_plan(fixture, driver, _checks(fixture, every) if narrow else every, budget) for fixture in chosen]
        for number, report in judge_plans(plans):
            yield chosen[number], report

    missed = []
    for fixture, report in judge_at("quick" if narrow else budget, fixtures):
        if narrow and fixture.codes and failing(report) != fixture.codes:
            missed.append(fixture)
        else:
            yield fixture, report
    yield from judge_at("standard", missed)


def judge_plans(plans: Sequence[Plan]) -> Iterator[tuple[int, SubjectReport]]:
    """Judge the first target of each plan; yield its index and its report, in the order in which they finish.

    The plans must have the same driver and limits.
    """
    if not plans:
        return
    # More than one subject, so that the workers come from a zygote, as in an audit.
    pool = WorkerPool(plans[0].driver, plans[0].limits, subjects=max(len(plans), 2))
    with pool, ThreadPoolExecutor(cores()) as threads:
        try:
            running = {threads.submit(_report, plan, pool): number for number, plan in enumerate(plans)}
            for done in as_completed(running):
                yield running[done], done.result()
        finally:
            pool.close()
            threads.shutdown(cancel_futures=True)


def failing(report: SubjectReport) -> frozenset[str]:
    """The codes of a report's errors; warnings do not count."""
    return frozenset(
        finding.code for check in report.checks for finding in check.findings if finding.severity is Severity.ERROR
    )


def _report(plan: Plan, pool: WorkerPool) -> SubjectReport:
    *_, last = judge(plan, plan.targets[0], pool)
    assert isinstance(last, SubjectFinished)
    return last.report


def _plan(fixture: Fixture, driver: Driver, checks: Sequence[Check], budget: str) -> Plan:
    policy = read_policy(str(fixture.policy)) if fixture.policy else None
    target = read_target(str(fixture.path))
    return Plan([target], ARCADE, driver, checks, BUDGETS[budget], limits=LIMITS, policy=policy, parallel_jobs=1)


def _checks(fixture: Fixture, every: Sequence[Check]) -> Sequence[Check]:
    """All checks for a good fixture, the checks of the expected codes for a bad one."""
    if not fixture.codes:
        return every
    expecting = {check.name for check in every if any(rule.code in fixture.codes for rule in check.rules)}
    return [check for check in every if check.always or check.gate or check.name in {fixture.check, *expecting}]
