"""``make demo``: validate ``examples/`` and compare the outcome with what the files say of themselves.

A file that begins with ``# expect: CODE`` is broken on purpose and must fail with that code; every other one must pass.
"""

from __future__ import annotations

import contextlib
import os
import re
import sys
from pathlib import Path

from envcraft.budget import BUDGETS
from envcraft.commands.choices import contract_named, default_checks, driver_named, rules_of
from envcraft.commands.targets import resolve
from envcraft.engine import Plan, validate
from envcraft.errors import EnvCraftError
from envcraft.events import Finished
from envcraft.progress import Progress
from envcraft.reports.console import ConsoleReporter
from envcraft.verdict import Report, Severity, SubjectReport, Verdict

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
_EXPECT = re.compile(r"# expect: (EC\d{3})")


def main() -> int:
    print("Validating examples/, as `envcraft validate examples --budget quick --exit-zero` does.\n", flush=True)
    try:
        report = run()
    except EnvCraftError as error:
        print(f"Error: {error}", file=sys.stderr)
        return int(error.exit_code)
    print("\nThe files named broken_* are broken on purpose, each in one way, and are expected to fail:\n")
    surprises = 0
    for subject in report.reports:
        wanted = expected(Path(subject.path))
        found = codes(subject)
        right = (subject.verdict is Verdict.FAIL and wanted in found) if wanted else subject.verdict is Verdict.PASS
        surprises += not right
        words = f"expected {wanted or 'to pass'}, found {', '.join(found) or subject.verdict}"
        print(f"  {'as expected ' if right else 'NOT EXPECTED'}  {Path(subject.path).name:<38} {words}")
    print(f"\n{len(report.reports) - surprises} of {len(report.reports)} as expected.")
    return int(surprises > 0)


def run() -> Report:
    """Validate all examples, with the console report on standard output."""
    checks = default_checks()
    workers = min(os.cpu_count() or 1, 4)
    reporter = ConsoleReporter(sys.stdout, rules_of(checks))
    with contextlib.closing(driver_named("auto")) as driver, Progress() as progress:
        targets = resolve(os.path.relpath(EXAMPLES))
        plan = Plan(targets, contract_named("arcade"), driver, checks, BUDGETS["quick"])
        with contextlib.closing(validate(plan, workers)) as events:
            for event in events:
                progress.handle(event)
                reporter.handle(event)
                if isinstance(event, Finished):
                    return event.report
    raise AssertionError("the validation ended without a report")


def expected(path: Path) -> str | None:
    """The code that a file expects for itself, or None where it expects to pass."""
    found = _EXPECT.match(path.read_text("utf-8"))
    return found[1] if found else None


def codes(subject: SubjectReport) -> list[str]:
    """The codes of a subject's errors, each once."""
    findings = [finding for check in subject.checks for finding in check.findings]
    return list(dict.fromkeys(finding.code for finding in findings if finding.severity is Severity.ERROR))


if __name__ == "__main__":
    sys.exit(main())
