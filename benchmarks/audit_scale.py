"""``python -m benchmarks.audit_scale``: what one more environment costs the auditing process, however many there are.

Corpora of 100, 1,000 and 10,000 environments are audited by ``envcraft audit --format json``, each in a process of its
own, with checks that play nothing and give verdicts of the size of real ones: what is left is the command's own part,
from the choice of what to judge to the last line of the report. The processor time of one more environment is held to
1.5 times that of the sizes before, and the peak memory of the process to 400 MiB; exit status 1 where one does not
hold. What judging itself takes does not know how many others there are: ``benchmarks.audit`` measures it.
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
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from benchmarks.corpus_store import CHECKS, add, report_of
from envcraft.check import Check
from envcraft.corpus.store import Store
from envcraft.sandbox import Availability, Driver, Isolation, JobEnd, Limits, Player, Recorder, Worker
from envcraft.subject import Subject
from envcraft.verdict import Finding

SIZES = (100, 1_000, 10_000)
RATIO, LIMIT_MIB = 1.5, 400


class _IdleWorker(Worker):
    def __init__(self) -> None:
        self.about = {}

    def preload(self, modules: list[str]) -> list[str]:
        return modules

    def find(self, modules: list[str]) -> tuple[list[str], list[str]]:
        return [], []

    def run(self, job: dict[str, Any], recorder: Recorder, limits: Limits, player: Player | None = None) -> JobEnd:
        raise AssertionError("nothing is to be run")

    def close(self) -> None:
        pass


class IdleDriver(Driver):
    """Of a sandbox in which nothing is run."""

    name = "none"
    isolation = Isolation.PROCESS
    rank = 1

    def probe(self) -> Availability:
        return Availability(True)

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return _IdleWorker()


class _Check(Check):
    """Finds in every fourth source what ``benchmarks.corpus_store`` has there."""

    rules = ()

    def __init__(self, name: str) -> None:
        self.name = name

    def judge(self, subject: Subject) -> Iterator[Finding]:
        for check in report_of(int(subject.text.partition("\n")[0][1:])).checks:
            if check.check == self.name:
                yield from check.findings


def audit(corpus: Path) -> None:
    """What ``envcraft audit`` does, with these checks in place of those that play. Tells processor seconds and MiB on
    standard error.
    """
    command = importlib.import_module("envcraft.commands.audit")
    in_place = {"driver_named": lambda *_, **__: IdleDriver(), "select_checks": lambda *_: list(map(_Check, CHECKS))}
    vars(command).update(in_place)
    started = time.process_time()
    with contextlib.suppress(click.exceptions.Exit):
        command.audit.main([str(corpus), "--format", "json"], standalone_mode=False)
    mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(time.process_time() - started, mib, file=sys.stderr)


def measured(size: int) -> tuple[float, float]:
    """Processor seconds and MiB of an audit of so many. Raises RuntimeError where it judged another number."""
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
    """Print the table; give 1 if a limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.audit_scale", description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES, help="at least two, the smallest first")
    parser.add_argument("--do", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    # Syncing each file takes what the disk takes, and is no part of what is measured.
    os.fsync = lambda fd: None
    if options.do:
        audit(options.do)
        return 0
    table = Table(title="the auditing process's own part of an audit")
    for column in ("environments", "CPU s", "for one more, CPU ms", "MiB"):
        table.add_column(column, justify="right")
    found = [(size, *measured(size)) for size in options.sizes]
    more = [(now[1] - before[1]) / (now[0] - before[0]) * 1000 for before, now in itertools.pairwise(found)]
    for (size, cpu, mib), one in zip(found, ["", *(f"{value:.2f}" for value in more)], strict=True):
        table.add_row(f"{size:,}", f"{cpu:.1f}", one, f"{mib:.0f}")
    console = Console(width=120)
    console.print(table)
    wrong = []
    if len(more) > 1 and more[-1] > RATIO * min(more[:-1]):
        wrong.append(f"one more environment costs {more[-1] / min(more[:-1]):.2f} times as much; at most {RATIO:g}")
    if found[-1][2] > LIMIT_MIB:
        wrong.append(f"the auditing process held {found[-1][2]:.0f} MiB; at most {LIMIT_MIB}")
    for line in wrong:
        console.print(f"limit broken: {line}")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
