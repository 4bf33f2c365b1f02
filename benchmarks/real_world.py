"""``python -m benchmarks.real_world REPORT.json ...``: how often each rule reports something in a set of environments.

A report is that of ``envcraft audit FOLDER --format json`` or ``envcraft validate FILES --format json``. The table
has the environments with a finding of each rule, their share of all that could be judged, and its 95% Clopper-Pearson
interval. ``--sample N`` prints N findings of each rule, drawn at random, to be read against the sources.
"""

from __future__ import annotations

import argparse
import json
import random
import statistics
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from envcraft.judging.statistics import Exact


def table(reports: Sequence[dict[str, Any]]) -> str:
    """The yields by rule in Markdown.

    Args:
        reports: the reports of single environments, as in the JSON format.
    """
    judged = [report for report in reports if report["verdict"] != "error"]
    verdicts = [report["verdict"] for report in judged]
    seconds = statistics.median(report["seconds"] for report in judged)
    lines = [
        f"{len(judged)} environments were judged, {len(reports) - len(judged)} could not be: {verdicts.count('pass')} "
        f"pass, {verdicts.count('fail')} fail. The median is {seconds:.1f} s of wall time and "
        f"{statistics.median(report['steps'] for report in judged):,.0f} steps.",
        "",
        "| code | severity | environments | share, with its 95% interval |",
        "|---|---|---|---|",
    ]
    for (code, severity), found in sorted(findings(judged).items()):
        rate = Exact(len(found), len(judged))
        lines.append(
            f"| {code} | {severity} | {len(found)} | {rate.estimate:.1%} ({rate.low:.1%} to {rate.high:.1%}) |"
        )
    return "\n".join(lines)


def findings(reports: Sequence[dict[str, Any]]) -> dict[tuple[str, str], dict[str, dict[str, Any]]]:
    """The first finding of each environment by code and severity, under the environment's path."""
    found: dict[tuple[str, str], dict[str, dict[str, Any]]] = defaultdict(dict)
    for report in reports:
        for check in report["checks"]:
            for finding in check["findings"]:
                found[finding["code"], finding["severity"]].setdefault(report["path"], finding)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, and a sample if it is requested."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.real_world", description=__doc__)
    parser.add_argument("report", type=Path, nargs="+")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="findings of each rule to print")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    reports = [report for path in options.report for report in json.loads(path.read_text("utf-8"))["reports"]]
    print(table(reports))
    rng = random.Random(options.seed)
    for (code, _), found in sorted(findings(reports).items()) if options.sample else ():
        for path in rng.sample(sorted(found), min(options.sample, len(found))):
            print(f"{code} {path}:{found[path].get('line') or ''} {found[path]['message']}")


if __name__ == "__main__":
    main()
