"""Judge many fixtures, those of one plan side by side and by the same zygote."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from benchmarks.fixtures import Fixture
from envcraft.check import Check
from envcraft.verdict import Severity, SubjectReport

Judged = Iterator[tuple[Fixture, SubjectReport]]


def judge(fixtures: Sequence[Fixture], sandbox: str = "auto", narrow: bool = False) -> Judged:
    """Give each fixture's report by all checks, as they come.

    With `narrow` good ones are judged at the budget `quick`, and bad ones by the checks alone whose codes they expect,
    at `standard` only where `quick` does not find them: what takes most of the time is looking for defects that are not
    there.
    """
    if not narrow:
        yield from _judge_at("standard", fixtures, sandbox, narrow)
        return
    missed = []
    for fixture, report in _judge_at("quick", fixtures, sandbox, narrow):
        if fixture.codes and failing(report) != fixture.codes:
            missed.append(fixture)
        else:
            yield fixture, report
    yield from _judge_at("standard", missed, sandbox, narrow)


def failing(report: SubjectReport) -> frozenset[str]:
    """The codes that failed a check; warnings do not."""
    return frozenset(
        finding.code for check in report.checks for finding in check.findings if finding.severity is Severity.ERROR
    )


def _judge_at(budget: str, fixtures: Sequence[Fixture], sandbox: str, narrow: bool) -> Judged:
    from envcraft.budget import BUDGETS
    from envcraft.commands.choices import default_checks
    from envcraft.contract import ARCADE
    from envcraft.engine import Plan, stream
    from envcraft.events import SubjectFinished
    from envcraft.plugins import plugins
    from envcraft.pool import Pool
    from envcraft.sandbox import choose
    from envcraft.target import read_policy, read_target

    registered = plugins()
    every = default_checks()
    driver = choose(registered.collect("envcraft_sandbox_drivers"), sandbox)
    for alike in _alike(fixtures, every, narrow):
        policy = alike[0].policy
        plan = Plan(
            targets=[read_target(str(fixture.path)) for fixture in alike],
            contract=ARCADE,
            driver=driver,
            checks=_checks(alike[0], every, narrow),
            budget=BUDGETS[budget],
            policy=read_policy(str(policy)) if policy else None,
        )
        # Workers as those of one among many, also where it is the only one: forked, but for the one that must share no
        # memory layout.
        pool = Pool(plan.driver, plan.limits, subjects=max(len(alike), 2))
        for number, event in stream(plan, pool=pool):
            if isinstance(event, SubjectFinished):
                yield alike[number - 1], event.report


def _alike(fixtures: Sequence[Fixture], every: Sequence[Check], narrow: bool) -> list[list[Fixture]]:
    """The fixtures in groups of the same checks and the same policy."""
    groups: dict[object, list[Fixture]] = {}
    for fixture in fixtures:
        names = tuple(check.name for check in _checks(fixture, every, narrow))
        groups.setdefault((fixture.policy, names), []).append(fixture)
    return list(groups.values())


def _checks(fixture: Fixture, every: Sequence[Check], narrow: bool) -> list[Check]:
    if not narrow or not fixture.codes:
        return list(every)
    expecting = {check.name for check in every if any(rule.code in fixture.codes for rule in check.rules)}
    return [check for check in every if check.always or check.name in {"source", fixture.check, *expecting}]
