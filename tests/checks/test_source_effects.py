"""What a finding blames on a file: neither a line of another file nor a warning of a library."""

from __future__ import annotations

import pytest
from envcraft_checks.api import Api
from envcraft_checks.source import Source

from envcraft.contracts.builtin import ARCADE
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.engine import Plan, validate
from envcraft.judging.selection import driver_named
from envcraft.model.events import Finished
from envcraft.model.target import Target
from envcraft.model.verdict import Finding
from evaluation.fixtures import FIXTURES

GAME = (FIXTURES / "api" / "bad" / "render_missing.py").read_text()


def findings(source: str, *checks: Check) -> dict[str, Finding]:
    *_, last = validate(
        Plan([Target("game.py", source.encode())], ARCADE, driver_named("process"), checks, BUDGETS["quick"])
    )
    assert isinstance(last, Finished)
    return {finding.code: finding for check in last.report.reports[0].checks for finding in check.findings}


def test_inherited_method_has_the_line_of_the_class() -> None:
    lines = GAME.splitlines()
    found = findings(GAME, Source(), Api())
    assert found["EC112"].line == lines.index("class MopEnv(gym.Env):") + 1


@pytest.mark.parametrize(("module", "blamed"), [("library.fonts", False), ("envcraft_subject", True)])
def test_only_warnings_of_the_file_count_as_output(module: str, blamed: bool) -> None:
    warning = f"import warnings\nwarnings.warn_explicit('no fonts', UserWarning, 'x.py', 1, module={module!r})\n"
    assert ("EC009" in findings(GAME + warning, Source())) is blamed
