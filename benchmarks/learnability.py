"""``python -m benchmarks.learnability``: the outcomes of the check ``learnability`` on small games, with several seeds.

:func:`evaluation.learnability.outcome` defines the outcomes. The budget is ``quick``. No other library has this check.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from evaluation.fixtures import expected
from evaluation.learnability import GAMES, judged, outcome


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a defect was missed or a good game has a finding."""
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
