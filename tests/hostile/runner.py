"""One run, in a process of its own: judge a hostile program, then an innocent one, with the same driver.

``python -m tests.hostile.runner`` reads its job from standard input and writes what came of it to standard output, both
JSON. The programs' code never runs here, only in the sandbox.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
import sys
import time
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from envcraft import pool
from envcraft.budget import Budget
from envcraft.check import Check
from envcraft.commands.choices import default_checks
from envcraft.contract import ARCADE
from envcraft.engine import Plan, validate
from envcraft.events import Finished, SubjectFinished
from envcraft.plugins import plugins
from envcraft.reports.console import ConsoleReporter
from envcraft.sandbox import Driver, Limits, choose
from envcraft.subject import Subject
from envcraft.target import Target
from envcraft.verdict import Finding, Report, Severity

#: Tight, so that hangs and bombs cost seconds.
LIMITS = Limits(call=1.5, loading=3.0, job=5.0, total=30.0, memory=256 * 1024**2, output_total=1024**2)
INNOCENT = Path(__file__).resolve().parents[2] / "examples" / "lander.py"
#: Of the innocent program only the traces matter, and few of them.
_GLANCE = Budget("glance", 1, 0, 2, 0, (1, 100), (200, 1), 0, 0, (6,), 100)
_GLANCES = ("source",)
#: Of a hostile program, too: a bomb goes off in each episode, and a few show as much as fifty.
_HOSTILE = Budget("hostile", 2, 1, 3, 0, (1, 60), (400, 1), 400, 0, (6, 12, 24), 100)


class Witness(Check):
    """Finds nothing, and remembers what a few traces of a subject show."""

    name = "witness"
    rules = ()
    always = True

    def __init__(self) -> None:
        self.digest = ""

    def judge(self, subject: Subject) -> Iterator[Finding]:
        seen = hashlib.sha256()
        players = subject.players
        for trace in subject.rollouts([players.random(0), players.random(1), players.noop(0)]):
            shown = (trace.ending, trace.observations, trace.infos, trace.rewards, trace.terminated, trace.truncated)
            seen.update(repr(shown).encode())
        self.digest = seen.hexdigest()
        return iter(())


def run(driver_name: str, program: str | None, values: dict[str, str], nursery: bool = False) -> dict[str, Any]:
    """Judge the program whose path is `program`, its placeholders filled from `values`, and then an innocent one; with
    `nursery` on workers as they are where there are many subjects.
    """
    if nursery:
        pool._FEW = 0
    registered = plugins()
    checks: list[Check] = default_checks()
    driver = choose(registered.collect("envcraft_sandbox_drivers"), driver_name)
    found: dict[str, Any] = {}
    try:
        if program is not None:
            found |= _judge(driver, checks, Path(program), values)
        witness = Witness()
        glances = [check for check in checks if check.name in _GLANCES]
        plan = Plan([_target(INNOCENT, {})], ARCADE, driver, [*glances, witness], _GLANCE, limits=LIMITS, lanes=1)
        started = time.monotonic()
        innocent = _report(plan).reports[0]
        found["innocent"] = {
            "verdict": innocent.verdict,
            "digest": witness.digest,
            "seconds": time.monotonic() - started,
            "reasons": [check.reason for check in innocent.checks if check.reason],
        }
    finally:
        driver.close()
    return found | {"peak": _peak()}


def _judge(driver: Driver, checks: list[Check], path: Path, values: dict[str, str]) -> dict[str, Any]:
    plan = Plan([_target(path, values)], ARCADE, driver, checks, _HOSTILE, limits=LIMITS, lanes=1)
    started = time.monotonic()
    report = _report(plan)
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


def _report(plan: Plan) -> Report:
    return next(event.report for event in validate(plan) if isinstance(event, Finished))


def _unprintable(report: Report, checks: list[Check]) -> list[str]:
    """Characters in the console's report that could steer a terminal. Raises where there can be no report at all."""
    json.loads(report.to_json())
    shown = io.StringIO()
    reporter = ConsoleReporter(shown, {rule.code: rule for check in checks for rule in check.rules})
    for event in (SubjectFinished(report.reports[0]), Finished(report)):
        reporter.handle(event)
    shown.getvalue().encode()
    signs = {sign for sign in shown.getvalue() if unicodedata.category(sign) in ("Cc", "Cf", "Cs")}
    return sorted(map(repr, signs - {"\n"}))


def _peak() -> int:
    """The most memory that this process ever held, in bytes."""
    told = Path("/proc/self/status").read_text()
    return int(told.partition("VmHWM:")[2].split()[0]) * 1024


if __name__ == "__main__":
    json.dump(run(**json.load(sys.stdin)), sys.stdout)
