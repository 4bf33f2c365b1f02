"""``python -m benchmarks.overhead``: the same rollouts in a plain loop and in each sandbox.

Each game runs in a plain loop ("bare") in a separate process, and in every available sandbox with one worker and one
job at a time. They take turns: each round plays the same episode in every way, and a ratio is the median over the
rounds of the ratios within one round, so a change in the speed of the machine affects both sides. A rollout in a
sandbox includes the fork, loading the file, and carrying every frame to the host and checking it there.

Speed is steps per wall-clock second, without the start of the process or the worker, which ``benchmarks.cold``
measures. CPU time covers everything from start to end, with the interpreter and the imports: for bare, the process; for
a sandbox, the worker, its jobs, the program that starts it (``bwrap``, the ``docker`` client) and this process. The CPU
time of the container engine does not count.

The exit status is 1 if a limit is broken.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import socket
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Protocol, Self

from envcraft_sandbox.client import ForkServerWorker
from rich.console import Console
from rich.table import Table

from envcraft.contracts.builtin import ARCADE
from envcraft.judging import actions
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Availability, Driver, Limits, Worker, choose
from envcraft.judging.subject import Subject
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.rollout import Rollout
from envcraft.model.target import read_target
from envcraft.plugins import plugins
from envcraft.spaces.spec import read_space

GAMES = Path(__file__).parent / "games"


@dataclass(frozen=True)
class Game:
    """A game, its number of rounds with one episode each, and its limits as multiples of bare.

    `cpu` is the most CPU time and `speed` the least speed; None is no limit.
    """

    name: str
    file: str
    episodes: int
    length: int
    cpu: float | None = None
    speed: float | None = None

    @property
    def path(self) -> Path:
        return GAMES / self.file

    def rollouts(self) -> list[Rollout]:
        """Random play, with one seed after the other."""
        seeds = range(self.episodes)
        return [Rollout(seed, actions.random_actions(read_space(ARCADE.action), seed, self.length)) for seed in seeds]


CHOSEN = (
    Game("trivial", "blink.py", 12, 1000),
    Game("numpy", "maze_walk.py", 9, 1000, cpu=1.25, speed=0.85),
    Game("pygame", "asteroids.py", 11, 250, cpu=1.05),
)


class Played(NamedTuple):
    """The number of steps and their wall-clock and CPU seconds."""

    steps: int
    seconds: float
    cpu: float


class Way(Protocol):
    """A way to play: bare, or in a sandbox."""

    def play(self, rollout: Rollout) -> Played:
        """Play an episode."""

    def close(self) -> float:
        """End it; return its total CPU seconds."""


class Bare:
    """A plain loop in a separate process."""

    def __init__(self, path: Path) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.bare", str(path)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={
                **os.environ,
                "SDL_VIDEODRIVER": "dummy",
                "SDL_AUDIODRIVER": "dummy",
                "PYGAME_HIDE_SUPPORT_PROMPT": "1",
            },
            text=True,
        )

    def play(self, rollout: Rollout) -> Played:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"seed": rollout.seed, "actions": rollout.actions}) + "\n")
        self._process.stdin.flush()
        return Played(*json.loads(self._process.stdout.readline()))

    def close(self) -> float:
        with _Stopwatch(resource.RUSAGE_CHILDREN) as children:
            self._process.communicate()
        return children.seconds


class Sandboxed:
    """Rollouts in a sandbox, as the checks request them."""

    def __init__(self, driver: Driver, path: Path) -> None:
        self._started: list[int] = []
        with _Stopwatch() as self._own:
            recording = _RecordingDriver(driver, self._started)
            self._subject = Subject(read_target(str(path)), ARCADE, WorkerPool(recording).lease(), BUDGETS["standard"])
            self._subject.load()

    def play(self, rollout: Rollout) -> Played:
        before = self._own.seconds
        with self._own:
            started = time.perf_counter()
            trace = self._subject.rollout(rollout)
            seconds = time.perf_counter() - started
        if not trace.usable or trace.end is None:
            raise RuntimeError(f"seed {rollout.seed} ended by {trace.ending}: {trace.fault or trace.end}")
        return Played(trace.steps, seconds, self._own.seconds - before + trace.end.cpu)

    def close(self) -> float:
        # RUSAGE_CHILDREN misses a worker that is killed when it closes.
        started = sum(map(_tree_cpu, self._started))
        with self._own:
            self._subject.close()
        return self._own.seconds + started


class _Stopwatch:
    """Adds up the CPU time of this process, or of the children that end, within its blocks."""

    def __init__(self, who: int = resource.RUSAGE_SELF) -> None:
        self.seconds = 0.0
        self._who = who

    def _read(self) -> float:
        used = resource.getrusage(self._who)
        return used.ru_utime + used.ru_stime

    def __enter__(self) -> Self:
        self.seconds -= self._read()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds += self._read()


class _RecordingDriver(Driver):
    """A driver that records the processes that each launch starts."""

    def __init__(self, driver: Driver, started: list[int]) -> None:
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self._driver, self._started = driver, started

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        before = _children(os.getpid())
        worker = self._driver.launch(hash_seed=hash_seed, limits=limits)
        self._started += [pid for pid in _children(os.getpid()) if pid not in before]
        self._started += _container(worker)
        return worker


def _container(worker: Worker) -> list[int]:
    """The fork server, from the credentials of its socket, if it is not a descendant of this process."""
    assert isinstance(worker, ForkServerWorker)
    credentials = worker._control.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    pid: int = struct.unpack("3i", credentials)[0]
    return [] if pid == os.getpid() else [pid]


def _children(pid: int) -> list[int]:
    found: list[int] = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        found += map(int, path.read_text().split())
    return found


def _tree_cpu(pid: int) -> float:
    """CPU seconds of a process and its descendants, with those that have ended."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    # utime, stime, cutime and cstime are fields 14 to 17; the first two fields are cut off.
    own = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return own + sum(map(_tree_cpu, _children(pid)))


@dataclass
class Measured:
    """Steps, steps per second and CPU seconds of one way to play one game."""

    steps: int
    speed: float
    cpu: float


def measure(game: Game, drivers: Sequence[Driver]) -> dict[str, Measured]:
    """Play one game bare (named ``bare``) and in each sandbox, in turns."""
    ways: dict[str, Way] = {"bare": Bare(game.path)}
    played: dict[str, list[Played]] = {"bare": []}
    total: dict[str, float] = {}
    try:
        for driver in drivers:
            ways[driver.name] = Sandboxed(driver, game.path)
            played[driver.name] = []
        for rollout in game.rollouts():
            for name, way in ways.items():
                played[name].append(way.play(rollout))
    finally:
        for name, way in ways.items():
            total[name] = way.close()
    if len({tuple(episode.steps for episode in episodes) for episodes in played.values()}) > 1:
        raise RuntimeError(f"the episodes of {game.file} differ in length: {played}")
    return {name: _summary(played[name], played["bare"], total[name]) for name in ways}


def _summary(played: list[Played], bare: list[Played], total: float) -> Measured:
    """CPU time outside the episodes counts as measured. An episode counts as the median bare episode times the median
    ratio to the bare episode of the same round.
    """
    pairs = list(zip(played, bare, strict=True))
    steps = sum(episode.steps for episode in played)
    speed = statistics.median(episode.steps / episode.seconds for episode in bare)
    speed *= statistics.median(beside.seconds / episode.seconds for episode, beside in pairs)
    cpu = statistics.median(episode.cpu / episode.steps for episode in bare)
    cpu *= statistics.median(episode.cpu / beside.cpu for episode, beside in pairs)
    return Measured(steps, speed, total - sum(episode.cpu for episode in played) + steps * cpu)


def broken(game: Game, measured: dict[str, Measured]) -> list[str]:
    """The broken limits, one sentence each."""
    found = []
    bare = measured["bare"]
    for name, way in measured.items():
        cpu, speed = way.cpu / bare.cpu, way.speed / bare.speed
        if game.cpu is not None and cpu > game.cpu:
            found.append(f"{game.name}, {name}: {cpu:.2f} times the CPU time of bare; at most {game.cpu:g}")
        if game.speed is not None and speed < game.speed:
            found.append(f"{game.name}, {name}: {speed:.2f} times the speed of bare; at least {game.speed:g}")
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table and the broken limits; return 1 if there are any."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.overhead", description=__doc__)
    parser.add_argument("--episodes", type=int, help="the number of episodes of each game")
    parser.add_argument("--game", choices=[game.name for game in CHOSEN], help="only this game")
    parser.add_argument("--sandbox", help="only this driver")
    options = parser.parse_args(arguments)
    drivers = working(options.sandbox)
    console = Console(width=120)
    table = Table(title=f"the same episodes bare and in {', '.join(driver.name for driver in drivers)}")
    for column in ("game", "way", "steps", "steps/s", "x bare", "at least", "CPU s", "x bare", "at most"):
        table.add_column(column, justify="left" if column in ("game", "way") else "right")
    wrong = []
    for game in CHOSEN:
        if options.game not in (None, game.name):
            continue
        if options.episodes:
            game = replace(game, episodes=options.episodes)
        measured = measure(game, drivers)
        wrong += broken(game, measured)
        bare = measured["bare"]
        for name, way in measured.items():
            speed, cpu = f"{way.speed / bare.speed:.2f}", f"{way.cpu / bare.cpu:.2f}"
            least, most = (f"{limit:g}" if limit and name != "bare" else "" for limit in (game.speed, game.cpu))
            label = game.name if name == "bare" else ""
            table.add_row(label, name, str(way.steps), f"{way.speed:,.0f}", speed, least, f"{way.cpu:.2f}", cpu, most)
        table.add_section()
    console.print(table)
    for line in wrong:
        console.print(f"limit broken: {line}")
    return int(bool(wrong))


def working(name: str | None = None) -> list[Driver]:
    """The available drivers, weakest first, or the driver called `name`. Raises SandboxUnavailable if there is none."""
    drivers: list[Driver] = sorted(plugins().collect("envcraft_sandbox_drivers"), key=lambda driver: driver.rank)
    if name is not None:
        return [choose(drivers, name)]
    works = []
    for driver in drivers:
        available = driver.probe()
        if available.works:
            works.append(driver)
        else:
            print(f"without {driver.name}: {available.reason}; {available.fix}", file=sys.stderr)
    return works or [choose(drivers, "auto")]


if __name__ == "__main__":
    raise SystemExit(main())
