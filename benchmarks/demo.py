"""``make demo``: validate ``examples/`` and compare the findings with the codes that the files expect.

A file that starts with ``# expect: CODE`` is broken on purpose and must fail with that code. No other file may fail,
but it is undecided if the search finds no win.
"""

from __future__ import annotations

import contextlib
import os
import sys
from pathlib import Path

from envcraft.cli.progress import Progress
from envcraft.contracts.lookup import contract_named
from envcraft.environments.targets import resolve
from envcraft.errors import EnvCraftError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named, rules_of
from envcraft.model.events import Finished
from envcraft.model.verdict import Report, Verdict
from envcraft.reports.console import ConsoleReporter
from evaluation.fixtures import ROOT, expected
from evaluation.judge import failing


def main() -> int:
    print("Validating examples/, as `envcraft validate examples --budget quick --exit-zero` does.\n", flush=True)
    try:
        report = run()
    except EnvCraftError as error:
        print(f"Error: {error}", file=sys.stderr)
        return int(error.exit_code)
    print("\nThe files named broken_* have one deliberate defect each and must fail:\n")
    surprises = 0
    for subject in report.reports:
        path = Path(subject.path)
        wanted, found = expected(path), failing(subject)
        right = subject.verdict is (Verdict.FAIL if wanted else Verdict.PASS) and wanted <= found
        surprises += not right
        words = f"expected {', '.join(wanted) or 'no failure'}, found {', '.join(sorted(found)) or subject.outcome}"
        print(f"  {'as expected ' if right else 'NOT EXPECTED'}  {path.name:<38} {words}")
    print(f"\n{len(report.reports) - surprises} of {len(report.reports)} as expected.")
    print(f"The files are in {os.path.relpath(ROOT / 'examples')}. Next, read about a finding and judge a file:\n")
    command = os.path.join(os.path.relpath(os.path.dirname(sys.executable)), "envcraft")
    game, policy = (os.path.relpath(ROOT / "examples" / name) for name in ("snake.py", "policies/snake.py"))
    print(f"  {command} explain EC203\n  {command} validate {game} --policy {policy}")
    return int(surprises > 0)


def run() -> Report:
    """Validate all examples and print the console report."""
    checks = default_checks()
    workers = min(os.cpu_count() or 1, 4)
    reporter = ConsoleReporter(sys.stdout, rules_of(checks))
    with contextlib.closing(driver_named("auto")) as driver, Progress() as progress:
        targets = resolve(os.path.relpath(ROOT / "examples"))
        plan = Plan(targets, contract_named("arcade"), driver, checks, BUDGETS["quick"])
        with contextlib.closing(validate(plan, workers)) as events:
            for event in events:
                progress.handle(event)
                reporter.handle(event)
                if isinstance(event, Finished):
                    return event.report
    raise AssertionError("the validation ended without a report")


if __name__ == "__main__":
    sys.exit(main())
