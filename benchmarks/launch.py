"""``python -m benchmarks.launch``: the cost of a worker, alone and in an audit of small environments.

*Workers*: each available driver launches workers one by one and ends them: directly, as for a single subject, and from
its zygote, as for many. A zygote that forks a single worker gives the cost of the zygote itself.

*Audit*: all checks judge small environments (good fixtures) at the budget ``quick``, with directly launched workers and
with forked ones, beside the same episodes in a plain loop in one process. Search steps, whose actions are not known
here, count as mean steps of that loop.

CPU time covers this process and its child processes; that of containers belongs to the engine. The exit status is 1 if
a forked worker takes more than a quarter of the CPU time of a launched one, in a sandbox without an engine.
"""

from __future__ import annotations

import argparse
import re
import resource
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import msgspec
from rich.console import Console
from rich.table import Table

from benchmarks.overhead import Bare, working
from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Availability, Driver, Isolation, Limits, Worker
from envcraft.judging.engine import Plan, open_subject, run_check
from envcraft.judging.selection import default_checks
from envcraft.judging.worker_pool import WorkerPool
from envcraft.model.rollout import Rollout
from envcraft.model.target import Target, read_target
from evaluation.fixtures import fixtures

#: The largest share of a launched worker's CPU time that a forked one may take.
_SHARE = 0.25


@dataclass
class Cost:
    """Wall-clock and CPU seconds."""

    seconds: float = 0.0
    cpu: float = 0.0


@contextmanager
def measured() -> Iterator[Cost]:
    cost = Cost(-time.perf_counter(), -_cpu())
    yield cost
    cost.seconds += time.perf_counter()
    cost.cpu += _cpu()


def _cpu() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


class Alone(Driver):
    """A driver that launches each worker directly."""

    def __init__(self, driver: Driver) -> None:
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self._driver = driver

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self._driver.launch(hash_seed=hash_seed, limits=limits)

    def start(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        return self._driver.start(hash_seed=hash_seed, limits=limits)


def launched(driver: Driver, count: int) -> Cost:
    """The cost of this many workers, from the driver's zygote if it has one."""
    shared = driver.shared_layout()
    with measured() as cost:
        for _ in range(count):
            shared.launch(hash_seed=0, limits=Limits()).close()
        if shared is not driver:
            shared.close()
    return cost


def compare_workers(driver: Driver, count: int) -> tuple[dict[str, Cost], bool]:
    """The cost of a launched worker, a forked worker and a zygote; and whether the limit holds."""
    alone = launched(Alone(driver), count)
    one, many = launched(driver, 1), launched(driver, count + 1)
    forked = Cost((many.seconds - one.seconds) / count, (many.cpu - one.cpu) / count)
    costs = {
        "launched": Cost(alone.seconds / count, alone.cpu / count),
        "forked": forked,
        "the zygote": Cost(one.seconds - forked.seconds, one.cpu - forked.cpu),
    }
    unknown = driver.isolation is Isolation.CONTAINER
    return costs, unknown or forked.cpu <= _SHARE * costs["launched"].cpu


def audited(driver: Driver, targets: Sequence[Target]) -> tuple[Cost, list[tuple[int, list[Rollout]]]]:
    """Judge the targets one after the other; return the cost, and the steps and episodes of each."""
    played = []
    plan = Plan(targets, ARCADE, driver, default_checks(), BUDGETS["quick"], parallel_jobs=1)
    with measured() as cost, WorkerPool(driver, plan.limits, len(targets)) as pool:
        for target in targets:
            with open_subject(plan, target, pool) as subject:
                for number, check in enumerate(plan.checks):
                    run_check(check, subject)
                    if number == 1:
                        subject.lease.reserve(seed for later in plan.checks for seed in later.hash_seeds)
                episodes = [msgspec.structs.replace(trace.rollout, actions=trace.actions) for trace in subject.traces]
                played.append((subject.steps, episodes))
    return cost, played


def bare(path: Path, steps: int, episodes: Sequence[Rollout]) -> float:
    """CPU seconds of this many steps in a plain loop, most of them in these episodes."""
    loop = Bare(path)
    try:
        played = [loop.play(episode) for episode in episodes]
    finally:
        loop.close()
    spent, taken = sum(each.cpu for each in played), sum(each.steps for each in played)
    return spent + max(steps - taken, 0) * spent / max(taken, 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 if the limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.launch", description=__doc__)
    parser.add_argument("--workers", type=int, default=20, help="workers to launch (default: %(default)s)")
    parser.add_argument("--environments", type=int, default=40, help="environments to judge (default: %(default)s)")
    parser.add_argument("--sandbox", help="only this driver")
    options = parser.parse_args(arguments)
    drivers = working(options.sandbox)
    console = Console(width=120)
    wrong = False
    table = _table("workers, one by one", "driver", "worker", "seconds", "CPU s")
    for driver in drivers:
        costs, holds = compare_workers(driver, options.workers)
        wrong |= not holds
        for name, cost in costs.items():
            table.add_row(driver.name, name, f"{cost.seconds:.3f}", f"{cost.cpu:.3f}")
    console.print(table)
    if options.environments:
        console.print(_audit(drivers, options.environments))
    if wrong:
        console.print(f"limit broken: a forked worker takes more than {_SHARE:g} of the CPU time of a launched one")
    return int(wrong)


def _audit(drivers: Sequence[Driver], count: int) -> Table:
    good = [fixture.path for fixture in fixtures() if not fixture.codes and fixture.policy is None]
    # Only files with one class: the plain loop has no contract to choose by. Sorted by name to mix the checks.
    single = [path for path in good if len(re.findall(r"^class ", path.read_text("utf-8"), re.MULTILINE)) == 1]
    paths = sorted(single, key=lambda path: path.name)[:count]
    targets = [read_target(str(path)) for path in paths]
    title = f"{len(paths)} environments at quick, mean"
    table = _table(title, "driver", "worker", "seconds", "CPU s", "times the plain loop")
    plain = None
    for driver in drivers:
        for name, way in (("launched", Alone(driver)), ("forked", driver)):
            cost, played = audited(way, targets)
            if plain is None:
                plain = sum(bare(path, *told) for path, told in zip(paths, played, strict=True))
                table.add_row("plain loop", "", "", f"{plain / len(paths):.3f}", "")
            each = [f"{value / len(paths):.3f}" for value in (cost.seconds, cost.cpu)]
            table.add_row(driver.name, name, *each, f"{cost.cpu / plain:.2f}")
    return table


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title)
    for column in columns:
        table.add_column(column, justify="left" if column in ("driver", "worker") else "right")
    return table


if __name__ == "__main__":
    raise SystemExit(main())
