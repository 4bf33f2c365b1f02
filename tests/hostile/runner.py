"""One run in a process of its own: judge a hostile program, then an innocent one, with the same driver.

The programs' code runs only in the sandbox.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import time
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, Limits, choose
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.events import Finished, SubjectFinished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding, Report, Severity
from envcraft.plugins import plugins
from envcraft.reports.console import ConsoleReporter

#: Short limits, so that a hang or a bomb costs seconds.
LIMITS = Limits(call=1.5, loading=3.0, job=5.0, memory=256 * 1024**2, output_total=1024**2)
INNOCENT = Path(__file__).resolve().parents[2] / "examples" / "lander.py"
#: The innocent program needs only a few traces.
_GLANCE = msgspec.structs.replace(
    BUDGETS["quick"],
    name="glance",
    play=300,
    sticky=0,
    held=2,
    explore=(100, 200, 1),
    exhaust=0,
    looks=(6,),
    length=100,
)
_GLANCES = ("source",)
#: A bomb explodes in each episode, so a few episodes show as much as fifty.
_HOSTILE = msgspec.structs.replace(
    BUDGETS["quick"], name="hostile", play=1_500, held=3, explore=(200, 400, 1), exhaust=400, length=100
)


class Witness(Check):
    """Reports no finding, and records a digest of several traces of a subject."""

    name = "witness"
    rules = ()
    always = True

    def __init__(self) -> None:
        self.digest = ""

    def judge(self, subject: Subject) -> Iterator[Finding]:
        seen = hashlib.sha256()
        probes = subject.probes
        for trace in subject.rollouts([probes.random(0), probes.random(1), probes.noop(0)]):
            shown = (trace.ending, trace.observations, trace.infos, trace.rewards, trace.terminated, trace.truncated)
            seen.update(repr(shown).encode())
        self.digest = seen.hexdigest()
        return iter(())


def run(driver_name: str, program: str | None, values: dict[str, str], forked: bool = False) -> dict[str, Any]:
    """Judge the program at the path `program`, then an innocent one.

    Args:
        driver_name: name of the driver.
        program: path of the hostile program; None: only the innocent one.
        values: values of the program's placeholders.
        forked: fork the workers, as for many subjects.
    """
    registered = plugins()
    checks: list[Check] = default_checks()
    driver = choose(registered.collect("envcraft_sandbox_drivers"), driver_name)
    found: dict[str, Any] = {}
    try:
        if program is not None:
            found |= _judge(driver, checks, Path(program), values, forked)
        witness = Witness()
        glances = [check for check in checks if check.name in _GLANCES]
        plan = Plan(
            [_target(INNOCENT, {})], ARCADE, driver, [*glances, witness], _GLANCE, limits=LIMITS, parallel_jobs=1
        )
        started = time.monotonic()
        innocent = _report(plan, forked).reports[0]
        found["innocent"] = {
            "verdict": innocent.verdict,
            "digest": witness.digest,
            "seconds": time.monotonic() - started,
            "reasons": [check.reason for check in innocent.checks if check.reason],
        }
    finally:
        driver.close()
    return found | {"peak": _peak()}


def _judge(driver: Driver, checks: list[Check], path: Path, values: dict[str, str], forked: bool) -> dict[str, Any]:
    plan = Plan([_target(path, values)], ARCADE, driver, checks, _HOSTILE, limits=LIMITS, parallel_jobs=1)
    started = time.monotonic()
    report = _report(plan, forked)
    seconds = time.monotonic() - started
    subject = report.reports[0]
    findings = [finding for check in subject.checks for finding in check.findings]
    return {
        "verdict": subject.verdict,
        "codes": sorted({finding.code for finding in findings if finding.severity is Severity.ERROR}),
        "words": [f"{finding.code} {finding.message}" for finding in findings]
        + [f"{check.check} {check.verdict}: {check.reason}" for check in subject.checks if check.reason],
        "seconds": seconds,
        "unprintable": _unprintable(report, checks),
    }


def _target(path: Path, values: dict[str, str]) -> Target:
    source = re.sub(r"@(\w+)@", lambda found: values.get(found[1], found[0]), path.read_text("utf-8"))
    return Target(path.name, source.encode())


def _report(plan: Plan, forked: bool) -> Report:
    # A pool for several subjects forks its workers.
    pool = WorkerPool(plan.driver, plan.limits, 2) if forked else None
    return next(event.report for event in validate(plan, pool=pool) if isinstance(event, Finished))


def _unprintable(report: Report, checks: list[Check]) -> list[str]:
    """Characters in the console's report that could control a terminal. Raises if there can be no report."""
    json.loads(report.to_json())
    shown = io.StringIO()
    reporter = ConsoleReporter(shown, {rule.code: rule for check in checks for rule in check.rules})
    for event in (SubjectFinished(report.reports[0]), Finished(report)):
        reporter.handle(event)
    shown.getvalue().encode()
    signs = {sign for sign in shown.getvalue() if unicodedata.category(sign) in ("Cc", "Cf", "Cs")}
    return sorted(map(repr, signs - {"\n"}))


def _peak() -> int:
    """The maximum memory of this process so far, in bytes."""
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024
