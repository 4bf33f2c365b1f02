"""The check `learnability` on small games, each judged as its header says; and that it runs only where it is named."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest
import torch
from click.testing import CliRunner
from envcraft_dqn import learnability
from envcraft_dqn.network import Network, weights_from
from envcraft_dqn.short_training import one_thread

from benchmarks.fixtures import expected
from benchmarks.learnability import CONTRACT, GAMES, judged, outcome
from envcraft.budget import BUDGETS
from envcraft.cli import cli
from envcraft.commands.choices import all_checks, default_checks, driver_named, select_checks
from envcraft.corpus.settings import settings_of
from envcraft.engine import Plan, open_subject, run_check
from envcraft.subject import Subject
from envcraft.target import read_target
from envcraft.verdict import SubjectReport, Verdict

BAD = GAMES[0].parent
#: One of each kind: ``python -m benchmarks.learnability`` judges all.
SOME = [
    game for game in GAMES if game.stem in {"better_idle", "coin", "jammed", "quits", "costly_buttons", "shown_lamp"}
]
BROKEN = BAD / "jammed.py"
LEARNABILITY = learnability.Learnability()
Opened = Callable[[Path], Subject]


@pytest.fixture(scope="module")
def reports() -> dict[Path, SubjectReport]:
    return dict(judged(SOME, 0, "process"))


@pytest.mark.slow
@pytest.mark.parametrize("game", SOME, ids=lambda game: game.stem)
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
@pytest.mark.parametrize("name", ["jammed", "quits"])
def test_what_breaks_in_training_can_be_seen_again(
    name: str, reports: dict[Path, SubjectReport], subject_of: Opened
) -> None:
    game = next(game for game in GAMES if game.stem == name)
    finding = next(finding for check in reports[game].checks for finding in check.findings if finding.code == "EC853")
    if name == "jammed":
        assert finding.line == 1 + game.read_text().splitlines().index('            raise RuntimeError("jammed")')
    # What does nothing for the defect is left out.
    assert sum(map(any, finding.repro.actions)) < 12
    subject = subject_of(game)
    assert LEARNABILITY.confirm(subject, finding) is finding
    mended = msgspec.structs.replace(finding.repro, actions=finding.repro.actions[:-1])
    assert LEARNABILITY.confirm(subject, msgspec.structs.replace(finding, repro=mended)) is None


@pytest.mark.slow
def test_the_numbers_do_not_hang_on_what_runs_beside(reports: dict[Path, SubjectReport]) -> None:
    [(_, alone)] = judged([BROKEN], 0, "process", workers=1)
    assert [check.findings for check in alone.checks] == [check.findings for check in reports[BROKEN].checks]


@pytest.fixture
def subject_of() -> Iterator[Opened]:
    with contextlib.ExitStack() as stack:

        def opened(game: Path) -> Subject:
            driver = stack.enter_context(contextlib.closing(driver_named("process")))
            plan = Plan([read_target(str(game))], CONTRACT, driver, [], BUDGETS["quick"])
            return stack.enter_context(open_subject(plan, plan.targets[0]))

        yield opened


def test_it_runs_only_where_it_is_named() -> None:
    assert "learnability" not in {check.name for check in [*default_checks(), *select_checks(None, "api")]}
    assert [check.name for check in select_checks("learnability", None)] == ["source", "learnability", "sandbox"]
    with contextlib.closing(driver_named("process")) as driver:
        whole, named, one = (
            settings_of(CONTRACT, checks, driver, BUDGETS["quick"], 0)
            for checks in (default_checks(), all_checks(), select_checks("learnability", None))
        )
    assert (whole.checks, whole.offered) == ("", "")
    # Neither displaces a verdict of all checks, nor does its failure take a pass back.
    for other in (named, one):
        assert other.checks
        assert other.offered == ""


def test_listings_say_that_it_has_to_be_named() -> None:
    told = json.loads(CliRunner().invoke(cli, ["checks", "--format", "json"]).stdout)
    assert {check["check"] for check in told if check["opt_in"]} == {"learnability"}
    assert "learnability (opt-in)" in CliRunner().invoke(cli, ["checks"]).stdout


def test_without_the_libraries_it_cannot_judge(monkeypatch: pytest.MonkeyPatch, subject_of: Opened) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    report = run_check(LEARNABILITY, subject_of(BROKEN))
    assert report.verdict is Verdict.ERROR
    assert "envcraft-rl[train]" in report.reason


def test_what_has_no_frames_is_skipped(tmp_path: Path, subject_of: Opened) -> None:
    game = tmp_path / "numbers.py"
    text = BROKEN.read_text().replace("(16, 16, 3)", "(16, 16)", 1).replace("return frame", "return frame[:, :, 0]")
    game.write_text(text)
    report = run_check(LEARNABILITY, subject_of(game))
    assert report.verdict is Verdict.SKIP
    assert "learns from frames" in report.reason


def test_returns_that_are_no_numbers_say_nothing(
    tmp_path: Path, subject_of: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(learnability._BUDGETS, "quick", (300, 2))
    game = tmp_path / "endless.py"
    game.write_text((BAD / "always_paid.py").read_text().replace("1.0, False", 'float("inf"), False'))
    report = run_check(LEARNABILITY, subject_of(game))
    assert report.verdict is Verdict.SKIP
    assert "not finite" in report.reason


def test_a_wrong_frame_is_a_finding(tmp_path: Path, subject_of: Opened) -> None:
    game = tmp_path / "wrong.py"
    game.write_text(
        BROKEN.read_text().replace('raise RuntimeError("jammed")', "return self.lamp, 0.0, False, False, {}")
    )
    report = run_check(LEARNABILITY, subject_of(game))
    assert [finding.code for finding in report.findings] == ["EC853"]


def test_episodes_without_an_end_are_cut(tmp_path: Path, subject_of: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(learnability._BUDGETS, "quick", (300, 2))
    game = tmp_path / "forever.py"
    game.write_text((BAD / "always_paid.py").read_text().replace("self.steps == 32", "False"))
    subject = subject_of(game)
    report = run_check(LEARNABILITY, subject)
    assert [finding.code for finding in report.findings] == ["EC851"]
    assert subject.length <= subject.steps <= 300 + 3 * 3 * subject.length


def test_no_more_time_is_taken_than_a_subject_has(tmp_path: Path, subject_of: Opened) -> None:
    subject = subject_of(BROKEN)
    subject.limits = msgspec.structs.replace(subject.limits, total=0.0)
    report = run_check(LEARNABILITY, subject)
    assert report.verdict is Verdict.SKIP
    assert "before the training was done" in report.reason


def test_one_thread_trains() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with one_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_two_networks_at_a_time_have_the_weights_of_their_seeds() -> None:
    def weights(seed: int) -> list[float]:
        with weights_from(seed):
            network = Network((84, 84, 3), (5, 2, 2), "tiny")
        return network.value.weight.flatten().tolist()

    torch.manual_seed(5)
    state = torch.random.get_rng_state()
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(weights, [1, 2] * 8))
    assert found == [weights(1), weights(2)] * 8
    assert torch.equal(torch.random.get_rng_state(), state)
