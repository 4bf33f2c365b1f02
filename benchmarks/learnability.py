"""``python -m benchmarks.learnability``: what the check of that name says of small games, under several seeds.

For a bad game: *caught* when the code that its header expects is reported, *wrong reason* when another is, *missed*
when none is. For a good one, any code is a *false alarm*. At the budget ``quick``; no other library judges this.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from benchmarks.fixtures import ROOT, expected
from envcraft.budget import BUDGETS
from envcraft.commands.choices import driver_named, select_checks
from envcraft.contract import GYMNASIUM
from envcraft.engine import Plan, stream
from envcraft.events import SubjectFinished
from envcraft.target import read_target
from envcraft.verdict import SubjectReport, Verdict

GAMES = sorted(ROOT.glob("tests/plugins/dqn/games/learnability/*/*.py"))
#: Small frames, so that training is quick, and an action that does nothing.
CONTRACT = msgspec.structs.replace(GYMNASIUM, noop=[0, 0])


def judged(
    games: Sequence[Path], seed: int, sandbox: str = "auto", workers: int | None = None
) -> Iterator[tuple[Path, SubjectReport]]:
    """Each game with the report on it, as they come."""
    targets = [read_target(str(game)) for game in games]
    with contextlib.closing(driver_named(sandbox)) as driver:
        plan = Plan(targets, CONTRACT, driver, select_checks("learnability", None), BUDGETS["quick"], seed)
        for number, event in stream(plan, workers):
            if isinstance(event, SubjectFinished):
                yield games[number - 1], event.report


def outcome(game: Path, report: SubjectReport) -> str:
    """As in the module's docstring, *wrong reason* also where it was not judged; "" for a good game that passes."""
    wanted = expected(game)
    found = {finding.code for check in report.checks for finding in check.findings}
    if any(check.verdict in (Verdict.SKIP, Verdict.ERROR) for check in report.checks):
        return "wrong reason"
    if not wanted:
        return "false alarm" if found else ""
    return "caught" if found == wanted else "wrong reason" if found else "missed"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; give 1 where a defect was missed or a good game has a finding."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.learnability", description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--sandbox", default="auto")
    options = parser.parse_args(arguments)
    found: dict[Path, Counter[str]] = {game: Counter() for game in GAMES}
    for seed in range(options.seeds):
        for game, report in judged(GAMES, seed, options.sandbox):
            found[game][outcome(game, report)] += 1
            print(f"seed {seed}: {game.stem}", file=sys.stderr)
    table = Table(title=f"learnability, {options.seeds} seeds")
    for column in ("game", "expected", "as expected", "missed", "false alarm", "wrong reason"):
        table.add_column(column)
    for game, counts in found.items():
        right = counts["caught"] + counts[""]
        others = [str(counts[name]) for name in ("missed", "false alarm", "wrong reason")]
        table.add_row(game.stem, ", ".join(sorted(expected(game))), str(right), *others)
    Console(width=120, file=sys.stdout).print(table)
    return int(any(counts[name] for counts in found.values() for name in ("missed", "false alarm", "wrong reason")))


if __name__ == "__main__":
    raise SystemExit(main())
