"""Reports on real programs with one job at a time and with several differ only in their times."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Limits, choose
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Report
from envcraft.plugins import plugins
from evaluation.judge import failing

STEP = "        self.steps += 1\n"
HANGS = f"        while self.steps > 30: pass\n{STEP}"


def judged(source: str, parallel_jobs: int) -> Report:
    registered = plugins()
    plan = Plan(
        [Target("game.py", source.encode())],
        ARCADE,
        choose(registered.collect("envcraft_sandbox_drivers"), "process"),
        default_checks(),
        BUDGETS["quick"],
        limits=Limits(call=1.0, loading=10.0),
        parallel_jobs=parallel_jobs,
    )
    return next(event.report for event in validate(plan) if isinstance(event, Finished))


def timeless(report: Any) -> Any:
    if isinstance(report, dict):
        return {key: timeless(value) for key, value in report.items() if key != "seconds"}
    return [timeless(value) for value in report] if isinstance(report, list) else report


@pytest.mark.parametrize(
    ("name", "edit", "codes"),
    [
        ("sokoban", STEP, set()),
        ("sokoban", HANGS, {"EC901"}),
        ("broken_pong_global_random", STEP, {"EC204"}),
        ("broken_miner_edge_crash", STEP, {"EC107"}),
    ],
    ids=["good", "hangs", "global-random", "crashes"],
)
def test_no_report_depends_on_the_number_of_parallel_jobs(root: Path, name: str, edit: str, codes: set[str]) -> None:
    source = (root / "examples" / f"{name}.py").read_text()
    assert STEP in source
    source = source.replace(STEP, edit, 1)
    reports = [judged(source, parallel_jobs) for parallel_jobs in (1, 3)]
    assert failing(reports[0].reports[0]) == codes
    one, several = (timeless(json.loads(report.to_json())) for report in reports)
    assert several == one
