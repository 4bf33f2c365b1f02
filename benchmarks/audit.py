"""``python -m benchmarks.audit``: what an audit costs beside the same episodes in a plain loop.

``--number`` environments are made by changing a tenth of the numbers in the good fixtures and the examples, as
``benchmarks.duplicates`` does; those that a plain loop cannot play, or not within ten seconds, are left out. They are
audited at the budget `quick`, by one worker and by two, each time from nothing. Processor time is that of the command
and of all that it starts, but for a container engine's own; bare is that of the very same episodes and searches in one
process (``benchmarks.bare_jobs``), without a sandbox and without a look at what comes back, played before the audits
and after them. Memory is the auditing process's own.

Exit status 1 when a limit does not hold: processor time 1.3 times bare, two workers 1.8 times as fast as one (where
there are two cores), 400 MiB.
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
from benchmarks.overhead import working
from envcraft import actions
from envcraft.budget import BUDGETS
from envcraft.commands.choices import default_checks
from envcraft.contract import ARCADE
from envcraft.engine import Plan
from envcraft.sandbox import Driver
from envcraft.target import read_target

NUMBER = 40
CPU, FASTER, LIMIT_MIB = 1.3, 1.8, 400
#: Steps of random play that a plain loop has to get through.
_STEPS = 1_000
#: Seconds after which an environment is left out.
_PATIENCE = 10


class Audited(NamedTuple):
    """One audit: wall-clock and processor seconds, steps, and MiB of the auditing process."""

    seconds: float
    cpu: float
    steps: int
    mib: float


def write(folder: Path, number: int) -> None:
    """Write so many environments that a plain loop can play."""
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
    """Raises TimeoutError when what it is around takes too long: some changed numbers make endless loops."""

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
    """Raises whatever the environment raises."""
    assert ARCADE.action is not None
    env = environment(path)
    steps = 0
    for seed in range(_STEPS):
        if steps < _STEPS:
            steps += play(env, seed, actions.random_actions(ARCADE.action, seed, _STEPS))[0]


def bare(folder: Path, driver: Driver) -> float:
    """Processor seconds of the jobs of an audit without a sandbox."""
    checks = default_checks()
    spent = 0.0
    for path in sorted(folder.iterdir()):
        plan = Plan([read_target(str(path))], ARCADE, driver, checks, BUDGETS["quick"])
        spent += sum(map(bare_jobs.seconds, bare_jobs.jobs_of(plan)))
    return spent


def audit(folder: Path, driver: str, workers: int) -> Audited:
    """Audit a folder from nothing. Raises RuntimeError where it could not be judged."""
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
    """The most MiB that a process has held, again and again until it ends."""
    yield 0.0
    while process.poll() is None:
        with contextlib.suppress(OSError, IndexError):
            told = Path(f"/proc/{process.pid}/status").read_text()
            yield int(told.partition("VmHWM:")[2].split()[0]) / 1024
        time.sleep(0.2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and the limits that are broken; give 1 if any is."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.audit", description=__doc__)
    parser.add_argument("--number", type=int, default=NUMBER)
    parser.add_argument("--sandbox", default="bubblewrap")
    options = parser.parse_args(arguments)
    [driver] = working(options.sandbox)
    with tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        write(Path(folder), options.number)
        before = bare(Path(folder), driver)
        audits = {workers: audit(Path(folder), driver.name, workers) for workers in (1, 2)}
        # On both sides of the audits, since a machine that others use is not equally fast for minutes.
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
                f"{workers} at a time: {ratio:.2f} times the processor time of the same jobs bare; at most {CPU:g}"
            )
        if done.mib > LIMIT_MIB:
            wrong.append(f"{workers} at a time: the auditing process held {done.mib:.0f} MiB; at most {LIMIT_MIB}")
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
