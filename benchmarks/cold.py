"""``python -m benchmarks.cold``: the time of one command from its start to the first step and to the verdict.

*Start-up* is the time from the start of ``envcraft validate`` until the host receives the environment's first step. The
limit is twice the time of ``python -c "import numpy, gymnasium"``: once for the imports that the worker needs, and once
for everything else. For docker the start of the container is measured separately and subtracted: a worker's container
with all its limits, whose interpreter does nothing.

*Validation* is the wall-clock time of ``envcraft validate`` on a good game, beside the time of the same number of steps
in a plain loop in one process.

The measurements take turns, from an empty folder; the first turn fills the file cache and does not count. The tables
show medians; a ratio is the median of the ratios within one turn, so a change in the speed of the machine affects both
sides. EnvCraft's modules are compiled first, as pip does on installation. The exit status is 1 if a limit is broken.
"""

from __future__ import annotations

import argparse
import compileall
import contextlib
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
from envcraft.contracts.builtin import ARCADE
from envcraft.judging import actions
from envcraft.judging.driver import Limits
from envcraft.spaces.spec import read_space

ROOT = Path(__file__).resolve().parent.parent
FIRST_STEP = GAMES / "first_step.py"
GOOD = ROOT / "examples" / "snake.py"
ROUNDS = 15
LIMIT = 2.0
#: The command ``envcraft``, which also prints on stderr the time at which the first exception of a step arrives. The
#: report does not have this time: its message comes from the reproduction, which runs later.
_LISTEN = """
import importlib.util, sys, time

class Listen:
    def find_spec(self, name, path=None, target=None):
        if name != "envcraft.judging.trace_builder":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        execute = spec.loader.exec_module
        def wrap(module):
            execute(module)
            fault = module.TraceBuilder.fault
            def timed(recording, report):
                if report.get("phase") == "step" and not stepped:
                    stepped.append(time.time())
                fault(recording, report)
            module.TraceBuilder.fault = timed
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
    """Seconds that Python takes to start and to import NumPy and Gymnasium."""
    return _run([sys.executable, "-c", "import numpy, gymnasium"])[0]


def container() -> float:
    """Seconds that the engine takes to start and remove a worker's container that does nothing."""
    from envcraft_sandbox import engine
    from envcraft_sandbox.build import TAG
    from envcraft_sandbox.docker import DockerDriver

    driver, client = DockerDriver(), engine.client()
    python = client.inspect_image(TAG)["Config"]["Entrypoint"][0]
    host = client.create_host_config(**driver.host_options(Limits()))
    options = driver.options(0) | {"entrypoint": [python], "command": ["-I", "-S", "-c", "pass"]}
    started = time.perf_counter()
    made = client.create_container(TAG, host_config=host, detach=True, **options)
    with contextlib.suppress(engine.NotFoundError), engine.errors():
        client.start(made)
        client.wait(made, condition="removed")
    return time.perf_counter() - started


def start_up(driver: str) -> float:
    """Seconds from the start of ``envcraft validate`` until the host receives the environment's first step."""
    before = time.time()
    # The quick budget shortens the part after the first step.
    words = ["validate", str(FIRST_STEP), "--sandbox", driver, "--exit-zero", "--budget", "quick"]
    _, _, stderr = _run([sys.executable, "-c", _LISTEN, *words])
    found = _STEPPED.search(stderr)
    if found is None:
        raise RuntimeError(f"no step was taken in the {driver} sandbox: {stderr}")
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
    assert ARCADE.limit is not None
    env = environment(path)
    space = read_space(ARCADE.action)
    played = [play(env, seed, actions.random_actions(space, seed, ARCADE.limit)) for seed in range(episodes)]
    return sum(steps for steps, *_ in played) / sum(seconds for _, seconds, _ in played)


def _run(argv: list[str]) -> tuple[float, str, str]:
    """Run a command; return its wall-clock seconds, stdout and stderr. Raises RuntimeError if it fails."""
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
    """Compile EnvCraft's modules; an editable installation does not."""
    for package in ("envcraft", "envcraft_checks", "envcraft_sandbox", "envcraft_protocol"):
        found = importlib.util.find_spec(package)
        for folder in (found.submodule_search_locations or []) if found else []:
            compileall.compile_dir(folder, quiet=2)


def in_turns(measures: dict[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    """Take the measures in turns, this many rounds after a first one that does not count."""
    taken: dict[str, list[float]] = {name: [] for name in measures}
    for number in range(rounds + 1):
        for name, measure in measures.items():
            seconds = measure()
            if number:
                taken[name].append(seconds)
    return taken


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables and the broken limits; return 1 if there are any."""
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
    for column in ("", "ms", "container alone, ms", "times the imports", "at most"):
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
    for column in ("", "seconds", "steps", "plain loop, seconds", "times the plain loop"):
        table.add_column(column, justify="right" if column else "left")
    for name in names:
        bare = steps[name] / statistics.mean(speeds)
        seconds = statistics.median(taken[name])
        table.add_row(name, f"{seconds:.2f}", f"{steps[name]:,}", f"{bare:.2f}", f"{seconds / bare:.2f}")
    console.print(table)


if __name__ == "__main__":
    raise SystemExit(main())
