"""The small games of the check ``learnability``, and their reports."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from envcraft.contracts.builtin import GYMNASIUM
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, stream
from envcraft.judging.selection import driver_named, select_checks
from envcraft.model.events import SubjectFinished
from envcraft.model.target import read_target
from envcraft.model.verdict import SubjectReport, Verdict
from evaluation.fixtures import ROOT, expected

GAMES = sorted(ROOT.glob("tests/plugins/dqn/games/learnability/*/*.py"))
#: Small frames for fast training, and an action that does nothing.
CONTRACT = msgspec.structs.replace(GYMNASIUM, noop=[0, 0])


def judged(
    games: Sequence[Path], seed: int, sandbox: str = "auto", workers: int | None = None
) -> Iterator[tuple[Path, SubjectReport]]:
    """Yield each game with its report, in the order in which they finish."""
    targets = [read_target(str(game)) for game in games]
    with contextlib.closing(driver_named(sandbox)) as driver:
        plan = Plan(targets, CONTRACT, driver, select_checks("learnability", None), BUDGETS["quick"], seed)
        for number, event in stream(plan, workers):
            if isinstance(event, SubjectFinished):
                yield games[number - 1], event.report


def outcome(game: Path, report: SubjectReport) -> str:
    """The outcome of a game: "" for a good game that passes.

    A bad game is *caught* if the code in its header is reported, *wrong reason* if another code is reported or the
    check did not run, and *missed* if none is. On a good game any code is a *false alarm*.
    """
    wanted = expected(game)
    found = {finding.code for check in report.checks for finding in check.findings}
    if any(check.verdict in (Verdict.SKIP, Verdict.ERROR) for check in report.checks):
        return "wrong reason"
    if not wanted:
        return "false alarm" if found else ""
    return "caught" if found == wanted else "wrong reason" if found else "missed"
