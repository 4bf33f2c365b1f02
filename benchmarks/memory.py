"""``python -m benchmarks.memory``: the most memory that the checker holds, however much an environment tells.

A game whose ``info`` is some 25 kB, and different at every step, is judged at the standard budget: more than a gigabyte
goes through the checker, and its peak resident size is held to 300 MiB. The worker is not counted. Exit status 1 when
the limit does not hold.
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
#: The command itself, in a process that tells its own peak when it ends, in KiB; ``ru_maxrss`` would be that of the
#: process that it was forked from where that held more.
_JUDGE = """
import sys
from envcraft.cli import cli
try:
    cli(["validate", *sys.argv[1:]], prog_name="envcraft")
finally:
    print(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0], file=sys.stderr)
"""


def peak(path: Path, driver: str, budget: str = "standard") -> tuple[float, int]:
    """Judge an environment; give the checker's peak resident size in MiB, and the steps judged. Raises RuntimeError."""
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
    """Print the table; give 1 if the limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.memory", description=__doc__)
    parser.add_argument("--sandbox", default="auto", help="through this driver; the checker is the same with all")
    parser.add_argument("--budget", default="standard")
    options = parser.parse_args(arguments)
    table = Table(title=f"the checker's peak resident size on {CHRONICLE.name}, budget {options.budget}")
    for column in ("", "steps", "MiB", "at most"):
        table.add_column(column, justify="right" if column else "left")
    (driver,) = working(options.sandbox)
    mebibytes, steps = peak(CHRONICLE, driver.name, options.budget)
    table.add_row(driver.name, f"{steps:,}", f"{mebibytes:.0f}", str(LIMIT_MIB))
    console = Console(width=120)
    console.print(table)
    if mebibytes > LIMIT_MIB:
        console.print(f"limit broken: the checker held {mebibytes:.0f} MiB; at most {LIMIT_MIB}")
    return int(mebibytes > LIMIT_MIB)


if __name__ == "__main__":
    raise SystemExit(main())
