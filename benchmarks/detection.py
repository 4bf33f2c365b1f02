"""``python -m benchmarks.detection``: which defects EnvCraft and its peers find in all fixtures.

A bad fixture is *caught* if the reported codes are exactly the codes in its header, *wrong reason* if other codes are
reported, and *missed* if none is. On a good fixture any failing code is a *false alarm*. The peers have no codes: an
exception or warning of a peer counts as caught if it mentions the topic of the check, which favours the peers.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from benchmarks.peers import PEERS, complaints
from evaluation.fixtures import Fixture, fixtures
from evaluation.judge import failing, judge_fixtures

_OUTCOMES = ("caught", "missed", "false alarm", "wrong reason")
#: The words that a peer's complaint must contain to be about the topic of a check.
_ABOUT = {
    "source": ".",
    "api": ".",
    "determinism": "determin|seed|random|equivalent|differ",
    "reward": "reward|float|nan|inf",
    "observation": "observation|render|image",
    "termination": "terminat|truncat|done|bool",
    "instawin": "win|success",
    "instadeath": "terminat|death|loses",
    "difficulty": "solv|trivial|polic",
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
    return "caught" if re.search(_ABOUT[fixture.check], complaint, re.IGNORECASE) else "wrong reason"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 if EnvCraft missed a defect or raised a false alarm."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.detection", description=__doc__)
    parser.add_argument("--sandbox", default="auto")
    parser.add_argument("--check", help="only the fixtures of this check")
    options = parser.parse_args(arguments)
    chosen = fixtures(options.check)
    counts: dict[tuple[str, str], Counter[str]] = {}
    wrong = []
    for number, (fixture, report) in enumerate(judge_fixtures(chosen, options.sandbox), 1):
        found = outcome(fixture, failing(report))
        counts.setdefault((fixture.check, "EnvCraft"), Counter())[found] += 1
        if found not in ("", "caught"):
            wrong.append(f"{found}: {fixture.name}: expected {sorted(fixture.codes)}, got {sorted(failing(report))}")
        print(f"\r{number} of {len(chosen)}", end="", file=sys.stderr)
    print(file=sys.stderr)
    said = complaints([fixture.path for fixture in chosen if fixture.policy is None])
    for fixture in chosen:
        for peer in PEERS if fixture.policy is None else ():
            counts.setdefault((fixture.check, peer), Counter())[
                peer_outcome(fixture, said[str(fixture.path)][peer])
            ] += 1
    _print(chosen, counts)
    for line in wrong:
        print(line)
    return 1 if wrong else 0


def _print(chosen: list[Fixture], counts: dict[tuple[str, str], Counter[str]]) -> None:
    console = Console(width=120)
    table = Table(title="caught / missed / false alarm / wrong reason")
    for column in ("check", "bad", "good", "EnvCraft", *PEERS):
        table.add_column(column)
    checks = list(_ABOUT)
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
