"""Judge every hostile program under every driver that works here: ``python -m tests.hostile.judge [NAME...]``.

Prints each unexpected result and a table. The exit status is 1 if an expectation or an invariant is broken.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import re
import resource
import select
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import get_context
from multiprocessing.util import Finalize
from pathlib import Path
from typing import Any, NoReturn

from envcraft_sandbox import leftovers
from envcraft_sandbox.worker import confine

from envcraft.judging.driver import Driver
from envcraft.judging.engine import cores
from envcraft.judging.selection import default_checks
from envcraft.plugins import plugins
from tests.hostile import runner
from tests.hostile.invariants import ROOT, Machine

PROGRAMS = Path(__file__).with_name("programs")
#: Maximum memory of the checker of a run, in bytes.
MEMORY = 1024**3
#: The innocent program takes one second alone. A program that makes it take this long has slowed the machine down.
INNOCENT_SECONDS = 30.0
#: Many runs wait for a deadline most of the time.
_POOL = cores() + 1
#: Without these layers the driver `process` protects only against accidents.
_HOLDING = {"Landlock", "system call filter"}
_PR_SET_PDEATHSIG = 1
_HEADER = re.compile(r"^# (does|verdict|codes|seconds|process): ?(.*)$", re.MULTILINE)


@dataclass(frozen=True)
class Program:
    """A hostile program and its header: the allowed verdicts, the codes of which a failure must show at least one, and
    the time limit in seconds.
    """

    path: Path
    does: str
    verdicts: frozenset[str]
    codes: frozenset[str]
    seconds: float
    process: bool

    @property
    def name(self) -> str:
        return self.path.stem


@dataclass
class Run:
    """The result of one program under one driver.

    Attributes:
        wrong: unexpected results.
        broken: broken invariants.
        late: one of these is an exceeded time limit.
    """

    program: str
    driver: str
    verdict: str = ""
    codes: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    seconds: float = 0.0
    peak: int = 0
    digest: str = ""
    late: bool = False
    wrong: list[str] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        complaints = "\n".join(f"  {words}" for words in [*self.wrong, *self.broken])
        messages = "\n".join(f"    {words[:200]}" for words in self.words)
        return f"{self.program} under {self.driver}: {self.verdict} in {self.seconds:.1f} s\n{complaints}\n{messages}"


def programs() -> list[Program]:
    """All hostile programs by name. Raises ValueError if a header is incomplete."""
    found = []
    for path in sorted(PROGRAMS.glob("*.py")):
        header = dict(_HEADER.findall(path.read_text("utf-8").partition('"""')[0]))
        verdicts = frozenset(header.get("verdict", "").split("|"))
        codes = frozenset(filter(None, header.get("codes", "").split("|")))
        if len(header) != 5 or not verdicts <= {"pass", "fail"} or ("fail" in verdicts) != bool(codes):
            raise ValueError(f"{path}: its header lacks does, verdict, codes, seconds or process, or they do not match")
        found.append(
            Program(path, header["does"], verdicts, codes, float(header["seconds"]), header["process"] == "yes")
        )
    return found


@cache
def drivers() -> dict[str, Driver]:
    """Every driver by name."""
    return {driver.name: driver for driver in plugins().collect("envcraft_sandbox_drivers")}


@cache
def missing(driver: str) -> str:
    """The reason why hostile programs cannot run under a driver here, or an empty string."""
    available = drivers()[driver].probe()
    if not available.works:
        return f"{available.reason}; {available.fix}"
    lacking = sorted(_HOLDING - set(confine.layers()[0]))
    if lacking and driver == "process":
        return f"this kernel has no {' and no '.join(lacking)}, without which hostile programs are not held"
    return ""


class Runs:
    """A pool that runs several programs at a time. Use as a context manager.

    `seen` are the runs whose results were read.
    """

    def __init__(self, workers: int = _POOL, forked: bool = False) -> None:
        self.seen: list[Run] = []
        self._forked = forked
        self._started = self._last = time.monotonic()
        # Spawned: a fork of the tests' process would have all that the tests hold.
        self._pool = ProcessPoolExecutor(workers, get_context("spawn"), initializer=_set_traps)
        self._alone: dict[str, Future[Run]] = {}
        self._runs: dict[tuple[str, str], Future[Run]] = {}

    def __enter__(self) -> Runs:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)

    def begin(self, program: Program, driver: str) -> None:
        """Queue a run, and before the first run of a driver one of the innocent program alone."""
        if driver not in self._alone:
            self._alone[driver] = self._pool.submit(_run, None, driver, self._forked)
        if (program.name, driver) not in self._runs:
            self._runs[program.name, driver] = self._pool.submit(_run, program, driver, self._forked)

    def result(self, program: Program, driver: str) -> Run:
        """Wait for a run, and compare the innocent program's traces with those of its run alone.

        A run that is late beside others is repeated after they have ended. A second request, by a rerun of a test, runs
        the program again.
        """
        if any((run.program, run.driver) == (program.name, driver) for run in self.seen):
            del self._runs[program.name, driver]
        self.begin(program, driver)
        run, alone = self._runs[program.name, driver].result(), self._alone[driver].result()
        if run.late and len(self._runs) > 1:
            run = self._pool.submit(_run, program, driver, self._forked).result()
        if run.digest != alone.digest and not run.broken:
            run.broken.append("the innocent program's traces differ from those of its run alone")
        self.seen.append(run)
        self._last = time.monotonic()
        return run

    def table(self) -> str:
        """The figures of the runs in Markdown."""
        return table(self.seen, self._last - self._started)


_machine: Machine | None = None


def _set_traps() -> None:
    global _machine
    # Forked checkers share what they import here.
    plugins()
    default_checks()
    _machine = Machine().__enter__()
    # The pool ends with its session, however that ends.
    signal.signal(signal.SIGTERM, _leave)
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    # The processes of a pool end without cleanup, and these have folders to remove.
    Finalize(None, _machine.__exit__, exitpriority=1)


def _leave(*_: object) -> None:
    """End this process at once. An exception would only become the result of its run."""
    if _machine is not None:
        _machine.__exit__()
    os._exit(1)


def _run(program: Program | None, driver: str, forked: bool) -> Run:
    """Run one program in a process of the pool."""
    machine = _machine
    assert machine is not None
    name = program.name if program else "(nothing)"
    path = str(program.path) if program else None
    job = {"driver_name": driver, "program": path, "values": machine.values, "forked": forked}
    patience = (program.seconds if program else 0.0) + 60
    started = time.monotonic()
    output, errors, status = _check(job, machine.environment, patience)
    seconds = time.monotonic() - started
    broken = machine.broken(driver)
    try:
        result = json.loads(output)
    except ValueError:
        how = f"{signal.Signals(-status).name}" if status < 0 else f"{status}"
        last = errors.decode(errors="replace").strip().splitlines()[-1:]
        return Run(
            name,
            driver,
            seconds=seconds,
            broken=[f"the checker ended with {how} after {seconds:.0f} s: {last}", *broken],
        )
    run = Run(
        name,
        driver,
        result.get("verdict", ""),
        tuple(result.get("codes", ())),
        tuple(result.get("words", ())),
        result.get("seconds", 0.0),
        result["peak"],
        result["innocent"]["digest"],
        broken=broken,
    )
    _compare(program, result, run)
    return run


def _check(job: dict[str, Any], environment: dict[str, str], seconds: float) -> tuple[bytes, bytes, int]:
    """Run a job in a checker of its own: a fork, which has the modules already. Kill it after `seconds`.

    Returns:
        Its output, its errors, and its status, which is negative for a signal.
    """
    output, errors = os.memfd_create("output"), os.memfd_create("errors")
    checker = os.fork()
    if not checker:
        _become_checker(job, environment, output, errors)
    ended = os.pidfd_open(checker)
    poll = select.poll()
    poll.register(ended, select.POLLIN)
    if not poll.poll(seconds * 1000):
        os.kill(checker, signal.SIGKILL)
    status = os.waitstatus_to_exitcode(os.waitpid(checker, 0)[1])
    os.close(ended)
    said = []
    for descriptor in (output, errors):
        with open(descriptor, "rb") as written:
            written.seek(0)
            said.append(written.read())
    return said[0], said[1], status


def _become_checker(job: dict[str, Any], environment: dict[str, str], output: int, errors: int) -> NoReturn:
    """Run a job and end this process, which is a fork of the pool's."""
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        with open(os.devnull) as nothing:
            os.dup2(nothing.fileno(), 0)
        os.dup2(output, 1)
        os.dup2(errors, 2)
        os.chdir(ROOT)
        os.environ.clear()
        os.environ.update(environment)
        tempfile.tempdir = None
        _bound_checker()
        json.dump(runner.run(**job), sys.stdout)
        # At the end of a process of its own, the folder would go.
        leftovers._own = None
        code = 0
    except BaseException:
        traceback.print_exc()
        code = 1
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _compare(program: Program | None, result: dict[str, Any], run: Run) -> None:
    """Note differences from the program's header, and what the checker itself allowed."""
    if program is not None:
        if run.verdict not in program.verdicts:
            run.wrong.append(f"the verdict is {run.verdict}, not {' or '.join(sorted(program.verdicts))}")
        elif run.verdict == "fail" and not program.codes & set(run.codes):
            run.wrong.append(f"the codes are {', '.join(run.codes)}: none of {', '.join(sorted(program.codes))}")
        if run.seconds > program.seconds:
            run.late = True
            run.wrong.append(f"it took {run.seconds:.1f} s, not {program.seconds:g} s")
        if result["unprintable"]:
            run.broken.append(f"the console's report contains {' '.join(result['unprintable'])}")
    innocent = result["innocent"]
    if innocent["verdict"] != "pass":
        run.broken.append(f"the innocent program got {innocent['verdict']}: {innocent['reasons']}")
    if innocent["seconds"] > INNOCENT_SECONDS:
        run.late = True
        run.broken.append(f"the innocent program took {innocent['seconds']:.1f} s")
    if run.peak > MEMORY:
        run.broken.append(f"the checker used {run.peak / 1024**2:.0f} MiB")


def _bound_checker() -> None:
    """Let the checker end with this process, and limit its memory if a program makes it grow."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    resource.setrlimit(resource.RLIMIT_DATA, (4 * 1024**3, 4 * 1024**3))


def pairs(chosen: Sequence[Program]) -> list[tuple[Program, str]]:
    """Programs and their drivers, the slowest first."""
    found = [(program, name) for program in chosen for name in drivers() if name != "process" or program.process]
    return sorted(found, key=lambda pair: -pair[0].seconds)


def judge(chosen: Sequence[tuple[Program, str]], workers: int = _POOL, forked: bool = False) -> Iterator[Run]:
    """Run them side by side and yield each result in order."""
    with Runs(workers, forked) as runs:
        for program, driver in chosen:
            runs.begin(program, driver)
        for program, driver in chosen:
            yield runs.result(program, driver)


def table(runs: Sequence[Run], seconds: float) -> str:
    """The figures of a session in Markdown."""
    lines = [
        "| driver | programs | as expected | invariants broken | slowest | checker's highest memory |",
        "|---|---|---|---|---|---|",
    ]
    for driver in dict.fromkeys(run.driver for run in runs):
        own = [run for run in runs if run.driver == driver]
        slowest = max(own, key=lambda run: run.seconds)
        good = sum(not run.wrong for run in own)
        broken = sum(bool(run.broken) for run in own)
        peak = max(run.peak for run in own) / 1024**2
        lines.append(
            f"| {driver} | {len(own)} | {good} | {broken or 'none'} | {slowest.seconds:.1f} s ({slowest.program}) "
            f"| {peak:.0f} MiB |"
        )
    return "\n".join([*lines, "", f"{len(runs)} runs in {seconds:.0f} s."])


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.judge", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help="Names of programs, or their beginnings.  [default: all]"
    )
    parser.add_argument("--driver", action="append", help="Use only this driver. May be repeated.")
    parser.add_argument("--workers", type=int, default=_POOL, help="Number of parallel runs.  [default: %(default)s]")
    parser.add_argument(
        "--forked", action="store_true", help="Fork the workers, as an audit of many environments does."
    )
    options = parser.parse_args()
    wanted = [program for program in programs() if program.name.startswith(tuple(options.names or [""]))]
    started = time.monotonic()
    for name in drivers():
        if reason := missing(name):
            print(f"not under {name}: {reason}", file=sys.stderr)
    runs = []
    chosen = [
        (program, driver)
        for program, driver in pairs(wanted)
        if not missing(driver) and driver in (options.driver or drivers())
    ]
    for run in judge(chosen, options.workers, options.forked):
        runs.append(run)
        if run.wrong or run.broken:
            print(run, file=sys.stderr, flush=True)
    print(table(runs, time.monotonic() - started))
    return int(any(run.wrong or run.broken for run in runs))


if __name__ == "__main__":
    sys.exit(main())
