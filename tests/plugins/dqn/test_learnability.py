"""The check `learnability` on small games with expected verdicts, and its opt-in."""

from __future__ import annotations

import contextlib
import json
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner
from envcraft_dqn import learnability

from envcraft.cli.group import cli
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import Limits
from envcraft.judging.engine import Plan, open_subject, run_check
from envcraft.judging.selection import all_checks, default_checks, driver_named, select_checks
from envcraft.judging.settings import settings_of
from envcraft.judging.subject import Subject
from envcraft.model.target import read_target
from envcraft.model.verdict import SubjectReport, Verdict
from evaluation.fixtures import expected
from evaluation.learnability import CONTRACT, GAMES, judged, outcome

BAD = GAMES[0].parent
#: One game of each kind. ``python -m benchmarks.learnability`` judges all.
SOME = [
    game for game in GAMES if game.stem in {"better_idle", "coin", "jammed", "quits", "costly_buttons", "shown_lamp"}
]
BROKEN = BAD / "jammed.py"
LEARNABILITY = learnability.Learnability()
LIMITS = Limits()
Opened = Callable[..., Subject]


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
def test_failures_in_training_are_reproducible(
    name: str, reports: dict[Path, SubjectReport], subject_of: Opened
) -> None:
    game = next(game for game in GAMES if game.stem == name)
    finding = next(finding for check in reports[game].checks for finding in check.findings if finding.code == "EC853")
    if name == "jammed":
        assert finding.line == 1 + game.read_text().splitlines().index('            raise RuntimeError("jammed")')
    # Shrinking removes actions that the defect does not need.
    assert sum(map(any, finding.repro.actions)) < 12
    subject = subject_of(game)
    assert LEARNABILITY.confirm(subject, finding) is finding
    mended = msgspec.structs.replace(finding.repro, actions=finding.repro.actions[:-1])
    assert LEARNABILITY.confirm(subject, msgspec.structs.replace(finding, repro=mended)) is None


@pytest.mark.slow
def test_findings_do_not_depend_on_parallel_subjects(reports: dict[Path, SubjectReport]) -> None:
    [(_, alone)] = judged([BROKEN], 0, "process", workers=1)
    assert [check.findings for check in alone.checks] == [check.findings for check in reports[BROKEN].checks]


@pytest.fixture
def subject_of() -> Iterator[Opened]:
    with contextlib.ExitStack() as stack:

        def opened(game: Path, seconds: float | None = None) -> Subject:
            driver = stack.enter_context(contextlib.closing(driver_named("process")))
            plan = Plan([read_target(str(game))], CONTRACT, driver, [], BUDGETS["quick"], time_limit=seconds)
            return stack.enter_context(open_subject(plan, plan.targets[0]))

        yield opened


def test_runs_only_if_named() -> None:
    assert "learnability" not in {check.name for check in [*default_checks(), *select_checks(None, "api")]}
    assert [check.name for check in select_checks("learnability", None)] == ["source", "learnability", "sandbox"]
    with contextlib.closing(driver_named("process")) as driver:
        whole, named, one = (
            settings_of(CONTRACT, checks, driver, BUDGETS["quick"], 0)
            for checks in (default_checks(), all_checks(), select_checks("learnability", None))
        )
    assert (whole.checks, whole.offered) == ("", "")
    # Such a verdict does not replace one of all checks, and its failure does not revoke a pass.
    for other in (named, one):
        assert other.checks
        assert other.offered == ""


def test_listings_show_that_it_is_opt_in() -> None:
    told = json.loads(CliRunner().invoke(cli, ["checks", "--format", "json"]).stdout)
    assert {check["check"] for check in told if check["opt_in"]} == {"learnability"}
    assert "learnability (opt-in)" in CliRunner().invoke(cli, ["checks"]).stdout


def test_missing_libraries_are_an_error(monkeypatch: pytest.MonkeyPatch, subject_of: Opened) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    report = run_check(LEARNABILITY, subject_of(BROKEN))
    assert report.verdict is Verdict.ERROR
    assert "envcraft-rl[train]" in report.reason


def test_observations_without_frames_are_skipped(tmp_path: Path, subject_of: Opened) -> None:
    game = tmp_path / "numbers.py"
    text = BROKEN.read_text().replace("(16, 16, 3)", "(16, 16)", 1).replace("return frame", "return frame[:, :, 0]")
    game.write_text(text)
    report = run_check(LEARNABILITY, subject_of(game))
    assert report.verdict is Verdict.SKIP
    assert "learns from frames" in report.reason


def test_infinite_returns_are_skipped(tmp_path: Path, subject_of: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(learnability._BUDGETS, "quick", (300, 2))
    game = tmp_path / "endless.py"
    game.write_text((BAD / "always_paid.py").read_text().replace("1.0, False", 'float("inf"), False'))
    report = run_check(LEARNABILITY, subject_of(game))
    assert report.verdict is Verdict.SKIP
    assert "not finite" in report.reason


def test_wrong_frame_is_a_finding(tmp_path: Path, subject_of: Opened) -> None:
    game = tmp_path / "wrong.py"
    game.write_text(
        BROKEN.read_text().replace('raise RuntimeError("jammed")', "return self.lamp, 0.0, False, False, {}")
    )
    report = run_check(LEARNABILITY, subject_of(game))
    assert [finding.code for finding in report.findings] == ["EC853"]


def test_endless_episodes_are_truncated(tmp_path: Path, subject_of: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(learnability._BUDGETS, "quick", (300, 2))
    game = tmp_path / "forever.py"
    game.write_text((BAD / "always_paid.py").read_text().replace("self.steps == 32", "False"))
    subject = subject_of(game)
    report = run_check(LEARNABILITY, subject)
    assert [finding.code for finding in report.findings] == ["EC851"]
    assert subject.length <= subject.steps <= 300 + 3 * 3 * subject.length


def test_time_limit_skips_the_check(tmp_path: Path, subject_of: Opened) -> None:
    subject = subject_of(BROKEN, 0.0)
    report = run_check(LEARNABILITY, subject)
    assert report.verdict is Verdict.SKIP
    assert report.reason == "out of time: the limit of 0 s is reached"


def test_training_uses_one_thread() -> None:
    import torch
    from envcraft_dqn.network import one_thread

    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        with one_thread():
            assert torch.get_num_threads() == 1
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_concurrent_networks_have_the_weights_of_their_seeds() -> None:
    import torch
    from envcraft_dqn.network import Network, seeded_weights

    def weights(seed: int) -> list[float]:
        with seeded_weights(seed):
            network = Network((84, 84, 3), (5, 2, 2), "tiny")
        return network.value.weight.flatten().tolist()

    torch.manual_seed(5)
    state = torch.random.get_rng_state()
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(weights, [1, 2] * 8))
    assert found == [weights(1), weights(2)] * 8
    assert torch.equal(torch.random.get_rng_state(), state)
