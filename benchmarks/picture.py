"""``make picture``: draw ``docs/report.svg``, the README's picture of a report, from a real run on three examples."""

from __future__ import annotations

import contextlib
import io
import os
import re
from pathlib import Path

from rich.console import Console

from envcraft.contracts.lookup import contract_named
from envcraft.environments.targets import resolve
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named, rules_of
from envcraft.reports.console import ConsoleReporter

ROOT = Path(__file__).resolve().parent.parent
SHOWN = ("sokoban.py", "broken_fox_old_footprints.py", "broken_breakout_unknown_import.py")
WIDTH = 100


def main() -> None:
    os.chdir(ROOT / "examples")
    checks = default_checks()
    console = Console(
        file=io.StringIO(), record=True, width=WIDTH, force_terminal=True, highlight=False, markup=False, emoji=False
    )
    console._environ = {}
    reporter = ConsoleReporter(io.StringIO(), rules_of(checks), console)
    console.print(f"$ envcraft validate {' '.join(SHOWN)}", soft_wrap=True, style="bold")
    console.print()
    with contextlib.closing(driver_named("auto")) as driver:
        targets = [target for path in SHOWN for target in resolve(path)]
        plan = Plan(targets, contract_named("arcade"), driver, checks, BUDGETS["standard"])
        for event in validate(plan):
            reporter.handle(event)
    svg = console.export_svg(title="envcraft validate", unique_id="envcraft")
    # Pictures in a README may not fetch fonts.
    svg = re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL).replace("Fira Code, monospace", "monospace")
    (ROOT / "docs" / "report.svg").write_text(svg, "utf-8")
    print("wrote docs/report.svg")


if __name__ == "__main__":
    main()
