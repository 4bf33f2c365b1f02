"""``python -m benchmarks.audit_scale``: how the cost of the auditing process grows with the corpus.

``envcraft audit --format json`` audits corpora of 100, 1,000 and 10,000 environments, each in a new process, with
checks that play nothing and give findings of realistic size. What remains is the cost of the command itself, from the
selection of environments to the last line of the report. ``benchmarks.audit`` measures the judging, whose cost does not
depend on the size of the corpus.

The exit status is 1 if a limit is broken: an additional environment costs 1.5 times the CPU time that it costs at a
smaller size, or the process uses 400 MiB.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import itertools
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from benchmarks.corpus_store import CHECKS, add, report_of
from envcraft.corpus.store import Store
from envcraft.judging.check import Check
from envcraft.judging.subject import Subject
from envcraft.model.verdict import Finding
from evaluation.drivers import IdleDriver

SIZES = (100, 1_000, 10_000)
RATIO, LIMIT_MIB = 1.5, 400


class _Check(Check):
    """Gives the findings that ``benchmarks.corpus_store`` has for the source."""

    rules = ()

    def __init__(self, name: str) -> None:
        self.name = name

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for check in report_of(int(subject.text.partition("\n")[0][1:])).checks:
            if check.check == self.name:
                yield from check.findings


def audit(corpus: Path) -> None:
    """Run ``envcraft audit`` with these checks; print its CPU seconds and MiB on standard error."""
    command = importlib.import_module("envcraft.cli.commands.audit")
    in_place = {"driver_named": lambda *_, **__: IdleDriver(), "select_checks": lambda *_: list(map(_Check, CHECKS))}
    vars(command).update(in_place)
    started = time.process_time()
    with contextlib.suppress(click.exceptions.Exit):
        command.audit.main([str(corpus), "--format", "json"], standalone_mode=False)
    mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(time.process_time() - started, mib, file=sys.stderr)


def measured(size: int) -> tuple[float, float]:
    """CPU seconds and MiB of an audit of this many environments. Raises RuntimeError if it judged another number."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder, "corpus")
        with Store.create(root) as store, store.transaction():
            add(store, range(size))
        command = [sys.executable, "-m", "benchmarks.audit_scale", "--do", str(root)]
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=True)
        with Store(root) as store:
            verdicts: int = store.db.execute("SELECT count(*) FROM verdicts").fetchone()[0]
    if verdicts != size:
        raise RuntimeError(f"{verdicts} verdicts on {size} environments: {done.stderr[-500:]}")
    cpu, mib = map(float, done.stderr.splitlines()[-1].split())
    return cpu, mib


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.audit_scale", description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="at least two, the smallest first")
    parser.add_argument("--do", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    # The time that the disk takes to sync is not part of the measurement.
    os.fsync = lambda fd: None
    if options.do:
        audit(options.do)
        return 0
    table = Table(title="the auditing process alone")
    for column in ("environments", "CPU s", "CPU ms for one more", "MiB"):
        table.add_column(column, justify="right")
    found = [(size, *measured(size)) for size in options.sizes]
    more = [(now[1] - before[1]) / (now[0] - before[0]) * 1000 for before, now in itertools.pairwise(found)]
    for (size, cpu, mib), one in zip(found, ["", *(f"{value:.2f}" for value in more)], strict=True):
        table.add_row(f"{size:,}", f"{cpu:.1f}", one, f"{mib:.0f}")
    console = Console(width=120)
    console.print(table)
    wrong = []
    if len(more) > 1 and more[-1] > RATIO * min(more[:-1]):
        wrong.append(
            f"an additional environment costs {more[-1] / min(more[:-1]):.2f} times as much; at most {RATIO:g}"
        )
    if found[-1][2] > LIMIT_MIB:
        wrong.append(f"the auditing process used {found[-1][2]:.0f} MiB; at most {LIMIT_MIB}")
    for line in wrong:
        console.print(f"limit broken: {line}")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
