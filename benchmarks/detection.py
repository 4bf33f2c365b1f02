"""``python -m benchmarks.detection``: who finds what, rule by rule, over all fixtures in one run.

For a bad fixture: *caught* when the codes that its header expects are exactly the ones reported, *wrong reason* when
something else is, *missed* when nothing is. For a good one, any failing code is a *false alarm*. The peers have no
codes: their complaint (an exception, or a warning) counts as caught when it speaks of the check's subject at all,
which is generous.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter

from rich.console import Console
from rich.table import Table

from benchmarks.fixtures import Fixture, fixtures
from benchmarks.judge import failing, judge
from benchmarks.peers import PEERS, complaints

_OUTCOMES = ("caught", "missed", "false alarm", "wrong reason")
#: What a peer's complaint must mention to be about a check's subject.
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
    """Classify what was reported on a fixture; "" for a good one that passed."""
    if not fixture.codes:
        return "false alarm" if reported else ""
    if reported == fixture.codes:
        return "caught"
    return "wrong reason" if reported else "missed"


def peer_outcome(fixture: Fixture, complaint: str) -> str:
    """The same for a peer's complaint."""
    if not fixture.codes:
        return "false alarm" if complaint else ""
    if not complaint:
        return "missed"
    return "caught" if re.search(_ABOUT[fixture.check], complaint, re.IGNORECASE) else "wrong reason"


def main() -> int:
    """Print the table and give 1 when EnvCraft missed something or raised a false alarm."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.detection", description=__doc__)
    parser.add_argument("--sandbox", default="auto")
    parser.add_argument("--check", help="only the fixtures of this check")
    options = parser.parse_args()
    chosen = fixtures(options.check)
    counts: dict[tuple[str, str], Counter[str]] = {}
    wrong = []
    for number, (fixture, report) in enumerate(judge(chosen, options.sandbox), 1):
        told = outcome(fixture, failing(report))
        counts.setdefault((fixture.check, "EnvCraft"), Counter())[told] += 1
        if told not in ("", "caught"):
            wrong.append(f"{told}: {fixture.name}: expected {sorted(fixture.codes)}, got {sorted(failing(report))}")
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
    console.print("Privileged policies are judged by EnvCraft only: the peers run none.")


def _cell(count: Counter[str]) -> str:
    return " / ".join(str(count[name]) for name in _OUTCOMES)


if __name__ == "__main__":
    raise SystemExit(main())
