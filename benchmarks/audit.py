"""``python -m benchmarks.audit``: the cost of an audit beside the same episodes in a plain loop.

The benchmark makes ``--number`` environments: it changes a tenth of the numbers in the good fixtures and the examples,
as ``benchmarks.duplicates`` does, and leaves out environments that a plain loop cannot play within ten seconds. It
audits them at the budget `quick`, first with one worker and then with two, each time with an empty store. CPU time
covers the command and its child processes, without the container engine. The plain loop runs the same episodes and
searches in one process (``benchmarks.bare_jobs``), without a sandbox and without checks, before and after the audits.
Memory is that of the auditing process. EnvCraft's modules are compiled first, as pip does on installation.

The exit status is 1 if a limit is broken: 1.5 times the CPU time of the plain loop, two workers 1.8 times as fast as
one (on two cores or more), 400 MiB.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from benchmarks import bare_jobs, duplicates
from benchmarks.bare import environment, play
from benchmarks.cold import compiled
from benchmarks.overhead import working
from envcraft.contracts.builtin import ARCADE
from envcraft.judging import actions
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Driver
from envcraft.judging.engine import Plan
from envcraft.judging.selection import default_checks
from envcraft.model.target import read_target
from envcraft.spaces.spec import read_space

NUMBER = 40
CPU, FASTER, LIMIT_MIB = 1.5, 1.8, 400
#: A plain loop must complete this many steps of random play.
_STEPS = 1_000
#: An environment that needs more seconds is left out.
_PATIENCE = 10


class Audited(NamedTuple):
    """One audit: wall-clock and processor seconds, steps, and MiB of the auditing process."""

    seconds: float
    cpu: float
    steps: int
    mib: float


def write(folder: Path, number: int) -> None:
    """Write this many environments that a plain loop can play."""
    rng = random.Random(0)
    written = 0
    for original in itertools.cycle(duplicates.originals()):
        if written == number:
            return
        path = folder / f"game_{written:05}.py"
        path.write_text(duplicates.edited(original.decode(), rng))
        # A changed number may break a game; the next one takes its place.
        with contextlib.suppress(Exception), _alarm():
            _try_out(path)
            written += 1


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    """Raises TimeoutError if the block takes too long: some changed numbers make endless loops."""

    def ring(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(_PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def _try_out(path: Path) -> None:
    """Play the environment. Raises any exception of the environment."""
    env = environment(path)
    steps = 0
    for seed in range(_STEPS):
        if steps < _STEPS:
            steps += play(env, seed, actions.random_actions(read_space(ARCADE.action), seed, _STEPS))[0]


def bare(folder: Path, driver: Driver) -> float:
    """CPU seconds of the jobs of an audit without a sandbox."""
    checks = default_checks()
    spent = 0.0
    for path in sorted(folder.glob("*.py")):
        plan = Plan([read_target(str(path))], ARCADE, driver, checks, BUDGETS["quick"])
        spent += sum(map(bare_jobs.seconds, bare_jobs.jobs_of(plan)))
    return spent


def audit(folder: Path, driver: str, workers: int) -> Audited:
    """Audit a folder with an empty store. Raises RuntimeError if the audit fails."""
    with tempfile.TemporaryDirectory(prefix="envcraft-") as store:
        words = ["audit", str(folder), "--store", f"{store}/store", "--sandbox", driver, "--budget", "quick"]
        command = [sys.executable, "-m", "envcraft", *words, "--workers", str(workers), "--format", "json"]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        started = time.perf_counter()
        with open(Path(store, "report.json"), "wb") as output:
            process = subprocess.Popen([*command, "--exit-zero"], stdout=output, stderr=subprocess.DEVNULL)
            mib = max(_watch(process))
        seconds = time.perf_counter() - started
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if process.returncode:
            raise RuntimeError(f"the audit ended with status {process.returncode}")
        reports = json.loads(Path(store, "report.json").read_text())["reports"]
    return Audited(seconds, sum(after[:2]) - sum(before[:2]), sum(report["steps"] for report in reports), mib)


def _watch(process: subprocess.Popen[bytes]) -> Iterator[float]:
    """Yield the peak memory of a process in MiB repeatedly until it ends."""
    yield 0.0
    while process.poll() is None:
        with contextlib.suppress(OSError, IndexError):
            status = Path(f"/proc/{process.pid}/status").read_text()
            yield int(status.partition("VmHWM:")[2].split()[0]) / 1024
        time.sleep(0.2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and the broken limits; return 1 if there are any."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.audit", description=__doc__)
    parser.add_argument("--number", type=int, default=NUMBER)
    parser.add_argument("--sandbox", default="bubblewrap")
    options = parser.parse_args(arguments)
    [driver] = working(options.sandbox)
    compiled()
    with tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        write(Path(folder), options.number)
        before = bare(Path(folder), driver)
        audits = {workers: audit(Path(folder), driver.name, workers) for workers in (1, 2)}
        # Before and after the audits: the speed of a shared machine changes over minutes.
        stepped = (before + bare(Path(folder), driver)) / 2
    faster = audits[1].seconds / audits[2].seconds
    table = Table(title=f"audit of {options.number} environments at quick, {driver.name}")
    for column in ("workers", "seconds", "CPU s", "bare, CPU s", "of bare", "steps", "MiB"):
        table.add_column(column, justify="right")
    wrong = []
    for workers, done in audits.items():
        ratio = done.cpu / stepped
        counted = f"{done.steps:,}"
        table.add_row(
            *(str(workers), f"{done.seconds:.1f}", f"{done.cpu:.1f}", f"{stepped:.1f}", f"{ratio:.2f}"),
            *(counted, f"{done.mib:.0f}"),
        )
        if ratio > CPU:
            wrong.append(
                f"{workers} workers: {ratio:.2f} times the CPU time of the same jobs in a plain loop; at most {CPU:g}"
            )
        if done.mib > LIMIT_MIB:
            wrong.append(f"{workers} workers: the auditing process used {done.mib:.0f} MiB; at most {LIMIT_MIB}")
    if (os.cpu_count() or 1) > 1 and faster < FASTER:
        wrong.append(f"two workers are {faster:.2f} times as fast as one; at least {FASTER:g}")
    console = Console(width=120)
    console.print(table)
    console.print(f"two workers: {faster:.2f} times as fast as one")
    for line in wrong:
        console.print(f"limit broken: {line}")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
