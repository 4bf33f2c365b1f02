"""Judge many fixtures side by side, each in a process of its own."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor

from benchmarks.fixtures import Fixture
from envcraft.verdict import Severity, SubjectReport


def judge(
    fixtures: Sequence[Fixture], sandbox: str = "auto", narrow: bool = False
) -> Iterator[tuple[Fixture, SubjectReport]]:
    """Give each fixture's report by all checks, in order, on as many processes as there are cores.

    With `narrow` good ones are judged at the budget `quick`, and bad ones by the checks alone whose codes they expect,
    at `standard` only where `quick` does not find them: what takes most of the time is looking for defects that are not
    there.
    """
    count = len(fixtures)
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        yield from zip(fixtures, pool.map(_judge_one, fixtures, [sandbox] * count, [narrow] * count), strict=True)


def failing(report: SubjectReport) -> frozenset[str]:
    """The codes that failed a check; warnings do not."""
    return frozenset(
        finding.code for check in report.checks for finding in check.findings if finding.severity is Severity.ERROR
    )


def _judge_one(fixture: Fixture, sandbox: str, narrow: bool) -> SubjectReport:
    if narrow:
        report = _judge_at("quick", fixture, sandbox, narrow)
        if not fixture.codes or failing(report) == fixture.codes:
            return report
    return _judge_at("standard", fixture, sandbox, narrow)


def _judge_at(budget: str, fixture: Fixture, sandbox: str, narrow: bool) -> SubjectReport:
    from envcraft.budget import BUDGETS
    from envcraft.contract import ARCADE
    from envcraft.engine import Plan, validate
    from envcraft.events import SubjectFinished
    from envcraft.plugins import plugins
    from envcraft.pool import Pool
    from envcraft.sandbox import choose
    from envcraft.target import read_policy, read_target

    registered = plugins()
    checks = registered.collect("envcraft_checks")
    if narrow and fixture.codes:
        expecting = {check.name for check in checks if any(rule.code in fixture.codes for rule in check.rules)}
        checks = [check for check in checks if check.always or check.name in {"source", fixture.check, *expecting}]
    plan = Plan(
        targets=[read_target(str(fixture.path))],
        contract=ARCADE,
        driver=choose(registered.collect("envcraft_sandbox_drivers"), sandbox),
        checks=checks,
        budget=BUDGETS[budget],
        policy=read_policy(str(fixture.policy)) if fixture.policy else None,
        # Each core has a fixture of its own.
        lanes=1,
    )
    # Workers as those of one among many: forked, but for the one that must share no memory layout.
    pool = Pool(plan.driver, plan.limits, subjects=2)
    return next(event.report for event in validate(plan, pool=pool) if isinstance(event, SubjectFinished))
