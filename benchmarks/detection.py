"""``python -m benchmarks.detection``: which defects EnvCraft and its peers find in all fixtures.

A bad fixture is *caught* if the reported codes are exactly the codes in its header, *wrong reason* if other codes are
reported, and *missed* if none is. On a good fixture any failing code is a *false alarm*. The peers have no codes: an
exception or warning of a peer counts as caught if it mentions the topic of the check, which favours the peers.

The second table has the recall and the false alarms at each budget beside what it costs: environment steps of every
kind and processor seconds a fixture. The exit status is 1 if `standard` has a wrong outcome, if any budget has a false
alarm, or if `quick` misses more than 5% of the defects.
"""

from __future__ import annotations

import argparse
import re
import resource
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from rich.console import Console
from rich.table import Table

from benchmarks.peers import PEERS, complaints
from envcraft.judging.budget import BUDGETS
from evaluation.fixtures import Fixture, fixtures
from evaluation.judge import failing, judge_fixtures

#: The share of the defects that `quick` may miss.
_LOST = 0.05
_OUTCOMES = ("caught", "missed", "false alarm", "wrong reason")
#: The words that a peer's complaint must contain to be about the topic of a check.
TOPICS = {
    "source": ".",
    "api": ".",
    "determinism": "determin|seed|random|equivalent|differ",
    "reward": "reward|float|nan|inf",
    "observation": "observation|render|image",
    "termination": "terminat|truncat|done|bool",
    "instawin": "win|success",
    "instadeath": "terminat|death|loses",
    "resources": "memory|thread|file|leak|slow",
    "difficulty": "solv|trivial|polic",
    "lint": ".",
}


def outcome(fixture: Fixture, reported: frozenset[str]) -> str:
    """The outcome of the codes reported on a fixture; "" for a good fixture that passed."""
    if not fixture.codes:
        return "false alarm" if reported else ""
    if reported == fixture.codes:
        return "caught"
    return "wrong reason" if reported else "missed"


def peer_outcome(fixture: Fixture, complaint: str) -> str:
    """The outcome of a peer's complaint."""
    if not fixture.codes:
        return "false alarm" if complaint else ""
    if not complaint:
        return "missed"
    return "caught" if re.search(TOPICS[fixture.check], complaint, re.IGNORECASE) else "wrong reason"


@dataclass
class Cost:
    """What one budget finds, and what it costs.

    Attributes:
        wrong: a line for each outcome that is not right.
        outcomes: how often each outcome occurs.
        steps: environment steps of all fixtures.
        seconds: processor seconds of all fixtures; None where the sandbox's processes are not this one's children.
    """

    wrong: list[str] = field(default_factory=list)
    outcomes: Counter[str] = field(default_factory=Counter)
    steps: int = 0
    seconds: float | None = None


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 where a limit is exceeded."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.detection", description=__doc__)
    parser.add_argument("--sandbox", default="auto")
    parser.add_argument("--check", help="only the fixtures of this check")
    parser.add_argument("--budget", action="append", choices=list(BUDGETS), help="default: quick and standard")
    options = parser.parse_args(arguments)
    chosen = fixtures(options.check)
    counts: dict[tuple[str, str], Counter[str]] = {}
    costs = {}
    for budget in options.budget or ["quick", "standard"]:
        costs[budget] = _judge(chosen, options.sandbox, budget, counts)
    said = complaints([fixture.path for fixture in chosen if fixture.policy is None])
    for fixture in chosen:
        for peer in PEERS if fixture.policy is None else ():
            counts.setdefault((fixture.check, peer), Counter())[
                peer_outcome(fixture, said[str(fixture.path)][peer])
            ] += 1
    _print(chosen, counts, budget)
    _print_costs(chosen, costs)
    for budget, cost in costs.items():
        for line in cost.wrong:
            print(f"{budget}: {line}")
    bad = sum(bool(fixture.codes) for fixture in chosen)
    failed = any(cost.outcomes["false alarm"] for cost in costs.values())
    failed |= any(cost.wrong for budget, cost in costs.items() if budget != "quick")
    return int(failed or ("quick" in costs and costs["quick"].outcomes["caught"] < (1 - _LOST) * bad))


def _judge(chosen: list[Fixture], sandbox: str, budget: str, counts: dict[tuple[str, str], Counter[str]]) -> Cost:
    """Judge all fixtures at one budget; the outcomes of the last budget stay in `counts`."""
    cost, before = Cost(), _processor_seconds()
    for check in TOPICS:
        counts[check, "EnvCraft"] = Counter()
    for number, (fixture, report) in enumerate(judge_fixtures(chosen, sandbox, budget=budget), 1):
        reached = outcome(fixture, failing(report))
        counts[fixture.check, "EnvCraft"][reached] += 1
        cost.outcomes[reached] += 1
        cost.steps += report.steps
        if reached not in ("", "caught"):
            codes = sorted(failing(report))
            cost.wrong.append(f"{reached}: {fixture.name}: expected {sorted(fixture.codes)}, got {codes}")
        print(f"\r{budget}: {number} of {len(chosen)}", end="", file=sys.stderr)
    print(file=sys.stderr)
    if report.driver != "docker":
        cost.seconds = _processor_seconds() - before
    return cost


def _processor_seconds() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(usage.ru_utime + usage.ru_stime for usage in used)


def _print_costs(chosen: list[Fixture], costs: dict[str, Cost]) -> None:
    table = Table(title="what a budget finds, and its cost for one fixture")
    for column in ("budget", "recall", "false alarms", "wrong reasons", "steps", "processor seconds"):
        table.add_column(column)
    bad = sum(bool(fixture.codes) for fixture in chosen)
    for budget, cost in costs.items():
        table.add_row(
            budget,
            f"{cost.outcomes['caught'] / bad:.1%}" if bad else "",
            str(cost.outcomes["false alarm"]),
            str(cost.outcomes["wrong reason"]),
            f"{cost.steps / len(chosen):,.0f}",
            "" if cost.seconds is None else f"{cost.seconds / len(chosen):.2f}",
        )
    Console(width=120).print(table)


def _print(chosen: list[Fixture], counts: dict[tuple[str, str], Counter[str]], budget: str) -> None:
    console = Console(width=120)
    table = Table(title=f"caught / missed / false alarm / wrong reason, at the budget {budget}")
    for column in ("check", "bad", "good", "EnvCraft", *PEERS):
        table.add_column(column)
    checks = list(TOPICS)
    total: dict[str, Counter[str]] = {name: Counter() for name in ("EnvCraft", *PEERS)}
    for check in checks:
        own = [fixture for fixture in chosen if fixture.check == check]
        if own:
            bad = sum(bool(fixture.codes) for fixture in own)
            row = [counts.get((check, name), Counter()) for name in total]
            for name, count in zip(total, row, strict=True):
                total[name] += count
            table.add_row(check, str(bad), str(len(own) - bad), *map(_cell, row))
    table.add_section()
    bad = sum(bool(fixture.codes) for fixture in chosen)
    table.add_row("all", str(bad), str(len(chosen) - bad), *map(_cell, total.values()))
    console.print(table)
    console.print("Only EnvCraft judges privileged policies.")


def _cell(count: Counter[str]) -> str:
    return " / ".join(str(count[name]) for name in _OUTCOMES)


if __name__ == "__main__":
    raise SystemExit(main())
