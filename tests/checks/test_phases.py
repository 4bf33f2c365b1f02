"""No message of the sandbox has an internal name of a phase as its subject."""

from __future__ import annotations

from pathlib import Path

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.events import SubjectFinished
from envcraft.model.target import Target

GAME = (Path(__file__).resolve().parents[2] / "examples" / "sokoban.py").read_text()
WAIT = "        import threading\n        threading.Thread(target=threading.Event().wait, daemon=True).start()\n"


def test_threads_of_earlier_episodes() -> None:
    reset = "        super().reset(seed=seed)\n"
    assert reset in GAME
    target = Target("game.py", GAME.replace(reset, reset + WAIT, 1).encode())
    checks = [check for check in default_checks() if check.name in ("source", "resources", "sandbox")]
    plan = Plan([target], ARCADE, driver_named("process"), checks, BUDGETS["standard"])
    report = next(event.report for event in validate(plan) if isinstance(event, SubjectFinished))
    (found,) = (found for check in report.checks for found in check.findings if found.code == "EC903")
    assert found.message.startswith("an earlier episode ")
    assert found.line is not None
    assert "Thread(" in target.source.decode().splitlines()[found.line - 1]
