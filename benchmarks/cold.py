"""``python -m benchmarks.cold``: how long one command takes, from nothing running to the first step and the verdict.

*Start-up* is the time from the start of ``envcraft validate`` until the host hears of the environment's first step. It
is held to twice the time of ``python -c "import numpy, gymnasium"``: the imports that the worker needs, and once more
for everything else. For docker the container's own start comes on top, which is measured beside it: a container as a
worker's, with all its limits, whose interpreter does nothing.

*Validation* is the wall-clock time of ``envcraft validate`` on a good game, beside the time that the steps that it
reports take in a plain loop in one process.

Everything is run in turns, from an empty folder, once before it counts so that the files are in memory. The medians are
given, and of ratios the median over the turns: a machine that is now faster and now slower is so for both. EnvCraft's
own modules are compiled first, as they are where pip has installed them. Exit status 1 when a limit does not hold.
"""

from __future__ import annotations

import argparse
import compileall
import functools
import importlib.util
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.bare import environment, play
from benchmarks.overhead import GAMES, working
from envcraft import actions
from envcraft.contract import ARCADE
from envcraft.sandbox import Limits

ROOT = Path(__file__).resolve().parent.parent
FIRST_STEP = GAMES / "first_step.py"
GOOD = ROOT / "examples" / "snake.py"
ROUNDS = 15
LIMIT = 2.0
#: The command ``envcraft``, but that it says on stderr when the first exception raised by a step arrives. The report
#: would not tell: its message is that of the reproduction, which is run later.
_LISTEN = """
import importlib.util, sys, time

class Listen:
    def find_spec(self, name, path=None, target=None):
        if name != "envcraft.recording":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        execute = spec.loader.exec_module
        def wrap(module):
            execute(module)
            fault = module.Recording.fault
            def told(recording, report):
                if report.get("phase") == "step" and not stepped:
                    stepped.append(time.time())
                fault(recording, report)
            module.Recording.fault = told
        spec.loader.exec_module = wrap
        return spec

stepped = []
sys.meta_path.insert(0, Listen())
from envcraft.__main__ import main
try:
    main()
finally:
    print("stepped at", *stepped, file=sys.stderr)
"""
_STEPPED = re.compile(r"stepped at (\d+\.\d+)")


def imports() -> float:
    """Seconds that Python takes to start and import what every environment imports."""
    return _run([sys.executable, "-c", "import numpy, gymnasium"])[0]


def container() -> float:
    """Seconds that the engine takes to start and end a container as a worker's that does nothing.

    Raises RuntimeError when the engine cannot.
    """
    from envcraft_sandbox.build import TAG
    from envcraft_sandbox.docker import DockerDriver

    told = subprocess.run(
        ["docker", "image", "inspect", "--format", "{{json .Config.Entrypoint}}", TAG],
        capture_output=True,
        check=True,
        text=True,
    )
    python = json.loads(told.stdout)[0]
    run = DockerDriver().command("envcraft-benchmark", 0, Limits())
    return _run([*run, "--entrypoint", python, TAG, "-I", "-S", "-c", "pass"])[0]


def start_up(driver: str) -> float:
    """Seconds from the start of ``envcraft validate`` until the host hears of the environment's first step."""
    before = time.time()
    # What comes after the first step takes less long so.
    words = ["validate", str(FIRST_STEP), "--sandbox", driver, "--exit-zero", "--budget", "quick"]
    _, _, told = _run([sys.executable, "-c", _LISTEN, *words])
    found = _STEPPED.search(told)
    if found is None:
        raise RuntimeError(f"no step was taken in the {driver} sandbox: {told}")
    return float(found[1]) - before


def validation(driver: str) -> tuple[float, int]:
    """Seconds that ``envcraft validate`` takes on a good game, and the steps that it reports."""
    argv = [sys.executable, "-m", "envcraft", "validate", str(GOOD), "--sandbox", driver, "--format", "json"]
    seconds, output, _ = _run([*argv, "--exit-zero"])
    report = json.loads(output)["reports"][0]
    if report["verdict"] != "pass":
        raise RuntimeError(f"{GOOD.name} is a good game, and the {driver} sandbox gave the verdict {report['verdict']}")
    return seconds, report["steps"]


def bare_speed(path: Path, episodes: int) -> float:
    """Steps per second of random play in a plain loop."""
    assert ARCADE.action is not None
    assert ARCADE.limit is not None
    env = environment(path)
    played = [play(env, seed, actions.random_actions(ARCADE.action, seed, ARCADE.limit)) for seed in range(episodes)]
    return sum(steps for steps, *_ in played) / sum(seconds for _, seconds, _ in played)


def _run(argv: list[str]) -> tuple[float, str, str]:
    """Run a command; give its wall-clock seconds, its output and what it said on stderr. Raises RuntimeError."""
    variables = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    with tempfile.TemporaryDirectory(prefix="envcraft-") as folder:
        started = time.perf_counter()
        done = subprocess.run(
            argv, cwd=folder, env=variables, stdin=subprocess.DEVNULL, capture_output=True, check=False, text=True
        )
        seconds = time.perf_counter() - started
    if done.returncode:
        raise RuntimeError(f"{argv[:3]} ended with status {done.returncode}: {done.stderr.strip()[-500:]}")
    return seconds, done.stdout, done.stderr


@functools.cache
def compiled() -> None:
    """Compile EnvCraft's modules, which in an editable installation is left to whoever imports them."""
    for package in ("envcraft", "envcraft_checks", "envcraft_sandbox", "envcraft_runtime"):
        found = importlib.util.find_spec(package)
        for folder in (found.submodule_search_locations or []) if found else []:
            compileall.compile_dir(folder, quiet=2)


def in_turns(measures: dict[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """Take each measure in turn, so many times and once before it counts."""
    taken: dict[str, list[float]] = {name: [] for name in measures}
    for number in range(rounds + 1):
        for name, measure in measures.items():
            seconds = measure()
            if number:
                taken[name].append(seconds)
    return taken


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables and the limits that are broken; give 1 if any is."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cold", description=__doc__)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--sandbox", help="only this driver")
    options = parser.parse_args(arguments)
    names = [driver.name for driver in working(options.sandbox)]
    compiled()
    console = Console(width=120)
    wrong = _print_start_up(console, names, options.rounds)
    _print_validation(console, names, max(options.rounds // 5, 1))
    for line in wrong:
        console.print(f"limit broken: {line}")
    return int(bool(wrong))


def _print_start_up(console: Console, names: list[str], rounds: int) -> list[str]:
    measures: dict[str, Callable[[], float]] = {"imports": imports}
    if "docker" in names:
        measures["container"] = container
    measures |= {name: functools.partial(start_up, name) for name in names}
    taken = in_turns(measures, rounds)
    seconds = {name: statistics.median(found) for name, found in taken.items()}
    table = Table(title="start-up: from the command to the first step, in ms")
    for column in ("", "ms", "the container's own", "of the imports", "at most"):
        table.add_column(column, justify="right" if column else "left")
    table.add_row('python -c "import numpy, gymnasium"', f"{1000 * seconds['imports']:.0f}", "", "1.00", "")
    wrong = []
    for name in names:
        own = seconds["container"] if name == "docker" else 0.0
        turns = zip(taken[name], taken["container"] if own else [0.0] * rounds, taken["imports"], strict=True)
        ratio = statistics.median((whole - alone) / imported for whole, alone, imported in turns)
        beside = f"{1000 * own:.0f}" if own else ""
        table.add_row(name, f"{1000 * seconds[name]:.0f}", beside, f"{ratio:.2f}", f"{LIMIT:g}")
        if ratio > LIMIT:
            wrong.append(f"{name}: start-up takes {ratio:.2f} times as long as the imports; at most {LIMIT:g}")
    console.print(table)
    return wrong


def _print_validation(console: Console, names: list[str], rounds: int) -> None:
    steps: dict[str, int] = {}

    def validated(name: str) -> float:
        seconds, steps[name] = validation(name)
        return seconds

    speeds = [bare_speed(GOOD, 20)]
    taken = in_turns({name: functools.partial(validated, name) for name in names}, rounds)
    speeds.append(bare_speed(GOOD, 20))
    table = Table(title=f"envcraft validate {GOOD.name}")
    for column in ("", "seconds", "steps", "stepped bare, seconds", "of bare"):
        table.add_column(column, justify="right" if column else "left")
    for name in names:
        bare = steps[name] / statistics.mean(speeds)
        seconds = statistics.median(taken[name])
        table.add_row(name, f"{seconds:.2f}", f"{steps[name]:,}", f"{bare:.2f}", f"{seconds / bare:.2f}")
    console.print(table)


if __name__ == "__main__":
    raise SystemExit(main())
