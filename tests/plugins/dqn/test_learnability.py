"""The check `learnability` on small games, each judged as its header says; and that it runs only where it is named."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import msgspec
import pytest
import torch
from click.testing import CliRunner

from benchmarks.fixtures import expected
from benchmarks.learnability import CONTRACT, GAMES, judged, outcome
from envcraft.budget import BUDGETS
from envcraft.cli import cli
from envcraft.commands.choices import all_checks, default_checks, driver_named, select_checks
from envcraft.corpus.settings import settings_of
from envcraft.engine import Plan, open_subject, run_check
from envcraft.target import read_target
from envcraft.verdict import SubjectReport, Verdict

BROKEN = next(game for game in GAMES if game.stem == "jammed")


@pytest.fixture(scope="module")
def reports() -> dict[Path, SubjectReport]:
    return dict(judged(GAMES, 0, "process"))


@pytest.mark.slow
@pytest.mark.parametrize("game", GAMES, ids=lambda game: game.stem)
def test_each_game_is_judged_as_expected(game: Path, reports: dict[Path, SubjectReport]) -> None:
    report = reports[game]
    [check] = [check for check in report.checks if check.check == "learnability"]
    assert outcome(game, report) in ("caught", ""), [finding.message for finding in check.findings] or check.reason
    assert check.verdict is (Verdict.FAIL if expected(game) - {"EC852"} else Verdict.PASS)
    for finding in check.findings:
        if finding.code != "EC853":
            lead = finding.evidence["lead"]
            assert lead["low"] <= lead["estimate"] <= lead["high"]
            assert lead["low"] <= 0


@pytest.mark.slow
def test_what_breaks_in_training_can_be_seen_again(reports: dict[Path, SubjectReport]) -> None:
    [finding] = [finding for check in reports[BROKEN].checks for finding in check.findings]
    assert finding.line == 1 + BROKEN.read_text().splitlines().index('            raise RuntimeError("jammed")')
    assert sum(map(all, finding.repro.actions)) >= 4
    [check] = [check for check in all_checks() if check.name == "learnability"]
    plan = Plan([read_target(str(BROKEN))], CONTRACT, driver_named("process"), [check], BUDGETS["quick"])
    with open_subject(plan, plan.targets[0]) as subject:
        assert check.confirm(subject, finding) is finding
        mended = msgspec.structs.replace(finding.repro, actions=finding.repro.actions[:-1])
        assert check.confirm(subject, msgspec.structs.replace(finding, repro=mended)) is None


def test_it_runs_only_where_it_is_named() -> None:
    assert "learnability" not in {check.name for check in [*default_checks(), *select_checks(None, "api")]}
    assert [check.name for check in select_checks("learnability", None)] == ["source", "learnability", "sandbox"]
    whole, driver = default_checks(), driver_named("process")
    named = select_checks(",".join(check.name for check in all_checks()), None)
    for checks in (whole, named):
        assert settings_of(CONTRACT, checks, driver, BUDGETS["quick"], 0).checks == ""
    assert settings_of(CONTRACT, select_checks("learnability", None), driver, BUDGETS["quick"], 0).checks


def test_listings_say_that_it_has_to_be_named() -> None:
    told = json.loads(CliRunner().invoke(cli, ["checks", "--format", "json"]).stdout)
    assert {check["check"] for check in told if check["opt_in"]} == {"learnability"}
    assert "learnability (opt-in)" in CliRunner().invoke(cli, ["checks"]).stdout


def test_without_the_libraries_it_cannot_judge(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    [check] = [check for check in all_checks() if check.name == "learnability"]
    plan = Plan([read_target(str(BROKEN))], CONTRACT, driver_named("process"), [check], BUDGETS["quick"])
    with open_subject(plan, plan.targets[0]) as subject:
        report = run_check(check, subject)
    assert report.verdict is Verdict.ERROR
    assert "envcraft-rl[train]" in report.reason


def test_what_has_no_frames_is_skipped(tmp_path: Path) -> None:
    threads = torch.get_num_threads()
    game = tmp_path / "numbers.py"
    game.write_text(
        GAMES[0].read_text().replace("(16, 16, 3)", "(16, 16)").replace("return frame", "return frame[:, :, 0]")
    )
    [report] = [report for _, report in judged([game], 0, "process")]
    [check] = [check for check in report.checks if check.check == "learnability"]
    assert check.verdict is Verdict.SKIP
    assert "learns from frames" in check.reason
    assert torch.get_num_threads() == threads
