"""``python -m benchmarks.memory``: the peak memory of the checker on an environment with much data.

The game has an ``info`` of some 25 kB that differs at every step. At the standard budget more than a gigabyte passes
through the checker. The exit status is 1 if the peak resident size exceeds 300 MiB; the worker does not count.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.overhead import GAMES, working

CHRONICLE = GAMES / "chronicle.py"
LIMIT_MIB = 300
#: The command, in a process that prints its own peak in KiB at its end. ``ru_maxrss`` would include the process that
#: forked it.
_JUDGE = """
import sys
from envcraft.cli.group import cli
try:
    cli(["validate", *sys.argv[1:]], prog_name="envcraft")
finally:
    print(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0], file=sys.stderr)
"""


def peak(path: Path, driver: str, budget: str = "standard") -> tuple[float, int]:
    """Judge an environment; return the checker's peak resident size in MiB, and the number of steps.

    Raises RuntimeError if the command fails.
    """
    argv = [sys.executable, "-c", _JUDGE, str(path), "--sandbox", driver, "--budget", budget]
    done = subprocess.run(
        [*argv, "--format", "json", "--exit-zero"],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"the {driver} sandbox ended with status {done.returncode}: {done.stderr.strip()[-500:]}")
    report = json.loads(done.stdout)["reports"][0]
    return int(done.stderr.split()[-1]) / 1024, report["steps"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if the limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--sandbox", default="auto", help="the driver; the checker is the same with each")
    parser.add_argument("--budget", default="standard")
    options = parser.parse_args(arguments)
    table = Table(title=f"peak resident size of the checker on {CHRONICLE.name}, budget {options.budget}")
    for column in ("", "steps", "MiB", "at most"):
        table.add_column(column, justify="right" if column else "left")
    (driver,) = working(options.sandbox)
    mebibytes, steps = peak(CHRONICLE, driver.name, options.budget)
    table.add_row(driver.name, f"{steps:,}", f"{mebibytes:.0f}", str(LIMIT_MIB))
    console = Console(width=120)
    console.print(table)
    if mebibytes > LIMIT_MIB:
        console.print(f"limit broken: the checker used {mebibytes:.0f} MiB; at most {LIMIT_MIB}")
    return int(mebibytes > LIMIT_MIB)


if __name__ == "__main__":
    raise SystemExit(main())
