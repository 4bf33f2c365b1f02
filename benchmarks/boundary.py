"""``python -m benchmarks.boundary``: a validation of a pygame game beside the same number of steps in a plain loop.

The game draws 640x400 pixels, some 400 steps a second, and is judged under ``arcade-native``. CPU time is that of the
command and all its child processes, from start to end. The plain loop ("bare") is one process that plays whole episodes
of random actions, with the interpreter and the imports; it runs before and after each validation, because the speed of
a shared machine changes, and its steps count as many times as the validation reports steps of every kind. The CPU time
of containers belongs to the engine, so the docker sandbox has a wall-clock time only. EnvCraft's modules are compiled
first, as pip does on installation.

The exit status is 1 if a limit is broken: 1.15 times the CPU time of bare; 20 seconds of wall clock at `quick`, and 75
at `standard`.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from benchmarks.cold import compiled
from benchmarks.overhead import GAMES, Bare, working
from envcraft.contracts.builtin import ARCADE_NATIVE
from envcraft.judging import actions
from envcraft.judging.driver import Isolation
from envcraft.model.rollout import Rollout
from envcraft.spaces.spec import read_space

GAME = GAMES / "gem_hunt.py"
CPU = 1.15
#: The longest wall-clock time by budget, in seconds.
WALL = {"quick": 20.0, "standard": 75.0}
#: Episodes of the plain loop, and steps of each.
_EPISODES, _LENGTH = 2, 1000


class Validated(NamedTuple):
    """One validation: wall-clock and processor seconds, and steps of every kind."""

    seconds: float
    cpu: float
    steps: int


def broken(sandbox: str, budget: str, seconds: float, ratio: float | None) -> list[str]:
    """The broken limits, one sentence each. `ratio` is that to the CPU time of bare, None if it is not known."""
    found = []
    if ratio is not None and ratio > CPU:
        found.append(f"{sandbox}, {budget}: {ratio:.2f} times the CPU time of bare; at most {CPU:g}")
    if seconds > WALL[budget]:
        found.append(f"{sandbox}, {budget}: {seconds:.1f} s; at most {WALL[budget]:g} s")
    return found


class Stepped(NamedTuple):
    """The plain loop: processor seconds of its start and its end, and of one step."""

    once: float
    step: float

    def cpu(self, steps: int) -> float:
        """Processor seconds of so many steps."""
        return self.once + steps * self.step


def bare() -> Stepped:
    """Play whole episodes in a plain loop."""
    way = Bare(GAME)
    try:
        played = [
            way.play(Rollout(seed, actions.random_actions(read_space(ARCADE_NATIVE.action), seed, _LENGTH)))
            for seed in range(_EPISODES)
        ]
    finally:
        total = way.close()
    spent = sum(episode.cpu for episode in played)
    return Stepped(total - spent, spent / sum(episode.steps for episode in played))


def validate(sandbox: str, budget: str) -> Validated:
    """Validate the game by the command. Raises RuntimeError if it does not pass."""
    words = ["validate", str(GAME), "--contract", ARCADE_NATIVE.name, "--sandbox", sandbox, "--budget", budget]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    started = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "envcraft", *words, "--format", "json"], capture_output=True, text=True, check=False
    )
    seconds = time.perf_counter() - started
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(f"the validation ended with status {done.returncode}: {done.stderr[-500:]}")
    [report] = json.loads(done.stdout)["reports"]
    return Validated(seconds, sum(after[:2]) - sum(before[:2]), report["steps"])


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and the broken limits; return 1 if there are any."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.boundary", description=__doc__)
    parser.add_argument("--sandbox", help="only this driver")
    parser.add_argument("--budget", choices=WALL, help="only this budget")
    options = parser.parse_args(arguments)
    drivers = [driver for driver in working(options.sandbox) if options.sandbox or driver.isolation != "process"]
    table = Table(title=f"validation of {GAME.name}, 640x400, under {ARCADE_NATIVE.name}")
    for column in ("sandbox", "budget", "steps", "seconds", "at most", "CPU s", "bare, CPU s", "of bare", "at most"):
        table.add_column(column, justify="left" if column in ("sandbox", "budget") else "right")
    wrong = []
    compiled()
    stepped = bare()
    for driver in drivers:
        for budget in [options.budget] if options.budget else WALL:
            done = validate(driver.name, budget)
            before, stepped = stepped, bare()
            beside = (before.cpu(done.steps) + stepped.cpu(done.steps)) / 2
            ratio = None if driver.isolation is Isolation.CONTAINER else done.cpu / beside
            cells = (
                ("", "", "", "") if ratio is None else (f"{done.cpu:.1f}", f"{beside:.1f}", f"{ratio:.2f}", f"{CPU:g}")
            )
            row = (driver.name, budget, f"{done.steps:,}", f"{done.seconds:.1f}", f"{WALL[budget]:g}", *cells)
            table.add_row(*row)
            wrong += broken(driver.name, budget, done.seconds, ratio)
    console = Console(width=120)
    console.print(table)
    console.print(f"bare: {1 / stepped.step:,.0f} steps per CPU second")
    for line in wrong:
        console.print(f"limit broken: {line}")
    return int(bool(wrong))


if __name__ == "__main__":
    raise SystemExit(main())
