"""``python -m benchmarks.launch``: what a worker costs, and what that is in an audit of small environments.

*Workers*: each driver that works here launches some, one by one, and ends them: by itself as for a single subject, and
from its nursery as for many. What the zygote costs is told apart, from a nursery that is asked for one worker alone.

*Audit*: small environments, good fixtures of the tests, are judged at the budget ``quick`` by all checks, once with
every worker launched by itself and once from a nursery, beside the time that the same episodes take in a plain loop in
one process. Steps of searches, of which no actions are told, count with the mean of that loop's.

Processor time is that of this process and of all that it started, to their ends. Exit status 1 where a forked worker
takes more than a quarter of the processor time of one that was launched.
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

from benchmarks.fixtures import fixtures
from benchmarks.overhead import Bare, working
from envcraft.budget import BUDGETS
from envcraft.commands.choices import default_checks
from envcraft.contract import ARCADE
from envcraft.engine import Plan, open_subject, run_check
from envcraft.pool import Pool
from envcraft.rollout import Rollout
from envcraft.sandbox import Availability, Driver, Limits, Worker
from envcraft.target import Target, read_target

#: A forked worker may take this much of the processor time of one that is launched.
_SHARE = 0.25


@dataclass
class Cost:
    """Seconds of wall-clock time and of processor time."""

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
    """A driver that launches each worker by itself, however many are wanted."""

    def __init__(self, driver: Driver) -> None:
        self.name, self.isolation, self.rank = driver.name, driver.isolation, driver.rank
        self._driver = driver

    def probe(self) -> Availability:
        return self._driver.probe()

    def launch(self, *, hash_seed: int, limits: Limits) -> Worker:
        return self._driver.launch(hash_seed=hash_seed, limits=limits)

    def begin(self, *, hash_seed: int, limits: Limits) -> Callable[[], Worker]:
        return self._driver.begin(hash_seed=hash_seed, limits=limits)


def launched(driver: Driver, count: int) -> Cost:
    """What so many workers cost, with all that is started for them; from the driver's nursery, if it has one."""
    nursery = driver.nursery()
    with measured() as cost:
        for _ in range(count):
            nursery.launch(hash_seed=0, limits=Limits()).close()
        if nursery is not driver:
            nursery.close()
    return cost


def compare_workers(driver: Driver, count: int) -> tuple[dict[str, Cost], bool]:
    """What one worker costs, launched and forked, and a zygote; and whether the limit holds."""
    alone = launched(Alone(driver), count)
    one, many = launched(driver, 1), launched(driver, count + 1)
    forked = Cost((many.seconds - one.seconds) / count, (many.cpu - one.cpu) / count)
    costs = {
        "launched": Cost(alone.seconds / count, alone.cpu / count),
        "forked": forked,
        "the zygote": Cost(one.seconds - forked.seconds, one.cpu - forked.cpu),
    }
    return costs, forked.cpu <= _SHARE * costs["launched"].cpu


def audited(driver: Driver, targets: Sequence[Target]) -> tuple[Cost, list[tuple[int, list[Rollout]]]]:
    """Judge them one after the other; what that costs, and for each the steps that it took and its episodes."""
    played = []
    plan = Plan(targets, ARCADE, driver, default_checks(), BUDGETS["quick"], lanes=1)
    with measured() as cost, Pool(driver, plan.limits, len(targets)) as pool:
        for target in targets:
            with pool.turn() as turn, open_subject(msgspec.structs.replace(plan, driver=turn), target) as subject:
                for number, check in enumerate(plan.checks):
                    run_check(check, subject)
                    if number == 1:
                        turn.expect(seed for later in plan.checks for seed in later.hash_seeds)
                episodes = [msgspec.structs.replace(trace.rollout, actions=trace.actions) for trace in subject.traces]
                played.append((subject.steps, episodes))
    return cost, played


def bare(path: Path, steps: int, episodes: Sequence[Rollout]) -> float:
    """Seconds of processor time that so many steps take, most of them in these episodes."""
    loop = Bare(path)
    try:
        told = [loop.play(episode) for episode in episodes]
    finally:
        loop.close()
    spent, taken = sum(each.cpu for each in told), sum(each.steps for each in told)
    return spent + max(steps - taken, 0) * spent / max(taken, 1)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; give 1 if the limit is broken."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.launch", description=__doc__)
    parser.add_argument("--workers", type=int, default=20, help="so many are launched (default: %(default)s)")
    parser.add_argument("--environments", type=int, default=40, help="so many are judged (default: %(default)s)")
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
        console.print(f"limit broken: a forked worker takes more than {_SHARE:g} of one that is launched")
    return int(wrong)


def _audit(drivers: Sequence[Driver], count: int) -> Table:
    good = [fixture.path for fixture in fixtures() if not fixture.codes and fixture.policy is None]
    # Of one class, which the plain loop finds without a contract; by name, so that they are from all families.
    single = [path for path in good if len(re.findall(r"^class ", path.read_text("utf-8"), re.MULTILINE)) == 1]
    paths = sorted(single, key=lambda path: path.name)[:count]
    targets = [read_target(str(path)) for path in paths]
    table = _table(f"{len(paths)} environments at quick, each", "driver", "worker", "seconds", "CPU s", "of bare")
    plain = None
    for driver in drivers:
        for name, way in (("launched", Alone(driver)), ("forked", driver)):
            cost, played = audited(way, targets)
            if plain is None:
                plain = sum(bare(path, *told) for path, told in zip(paths, played, strict=True))
                table.add_row("bare", "", "", f"{plain / len(paths):.3f}", "")
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
