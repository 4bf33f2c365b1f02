"""A study of the smallest scale from the command line to its report, and its interruptions."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from envcraft_dqn.files import exclusive
from envcraft_dqn.study import commands, selection
from envcraft_dqn.study.presets import PRESETS

from envcraft.cli.group import cli
from envcraft.corpus.store import Store, environments

_OPTIONS = ("--scale", "smoke", "--device", "cpu", "--sandbox", "process")


def study(folder: Path, *more: str) -> Result:
    arguments = ["study", "generalisation", "--output", str(folder), *_OPTIONS, *more]
    return CliRunner().invoke(cli, arguments)


def results(folder: Path) -> dict[str, dict[str, Any]]:
    """All results without the times."""
    found = {path.name: json.loads(path.read_text()) for path in (folder / "results").glob("*.json")}
    for one in found.values():
        assert one.pop("seconds") > 0
        del one["processor_seconds"]
    return found


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An uninterrupted study."""
    folder = tmp_path_factory.mktemp("whole") / "study"
    result = study(folder, "--workers", "0")
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(folder / "report.md")
    return folder


def test_report(whole: Path) -> None:
    summary = json.loads((whole / "summary.json").read_text())
    report = (whole / "report.md").read_text()
    found = results(whole)
    trained = [one for one in found.values() if one["task"]["kind"] == "train"]
    assert len(trained) == 4
    for one in trained:
        first, starts, phases = (30, 0, {"pretraining", "training"})
        if not one["task"]["demonstrations"]:
            first, starts, phases = 0, 20, {"training"}
        assert one["updates"] == first + (one["steps"] - starts) // 4
        assert {point["phase"] for point in one["curve"]} == phases
    conditions = summary["conditions"]
    every = ["agent", "pretrained", "without demonstrations", "untrained", "noop", "coin flip", "constant", "shuffled"]
    every += ["familiar", "privileged", "seed 2"]
    assert list(conditions) == every
    rows = {row["condition"]: row for row in summary["competence"]["held_out"]}
    assert rows.keys() == {*every, "random"} - {"familiar"}
    for name, row in rows.items():
        assert row["count"] == (3 if name in ("without demonstrations", "seed 2") else 6)
        assert {"return", "length"} <= row["means"].keys()
    assert rows["random"]["means"]["return"]["mean"] == 0
    assert rows["privileged"]["means"]["return"]["mean"] == pytest.approx(100)
    # The gate: thirty updates teach nothing, and the report says so instead of a figure.
    training = {row["condition"]: row for row in summary["competence"]["training"]}
    controls = ["random", "noop", "coin flip", "constant", "shuffled", "untrained"]
    assert list(training) == ["agent", *controls, "privileged"]
    unbeaten = summary["competence"]["unbeaten"]
    assert unbeaten == [
        name
        for name, row in training.items()
        if name not in ("agent", "privileged") and row["leads"]["return"]["low"] <= 0
    ]
    assert unbeaten
    assert "The gate is not passed" in report
    assert "it performs better than chance" not in report
    for words in (
        "coin flip: random moves without buttons",
        "untrained network",
        "doing nothing",
        "the ceiling",
        "not due to the demonstrations alone",
    ):
        assert words in report
    page = (whole / "report.html").read_text()
    for name in ("agent", "pretrained", "conditions", "curves"):
        assert f"(figures/{name}.png)" in report
        assert f'src="figures/{name}.png"' in page
        assert (whole / "figures" / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_killed_study_resumes_to_the_same_results(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "study"
    # A part of the whole study, whose tasks must have the same results.
    fewer = ("--controls", "0", "--privileged-episodes", "0")
    command = [sys.executable, "-m", "envcraft", "study", "generalisation", "--output", str(folder), *_OPTIONS, *fewer]
    null = subprocess.DEVNULL
    with subprocess.Popen([*command, "--workers", "2"], stdout=null, stderr=null) as process:
        deadline = time.monotonic() + 480
        while len(list((folder / "results").glob("*.json"))) < 3:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        process.send_signal(signal.SIGKILL)
    kept = {path: path.stat().st_mtime_ns for path in (folder / "results").glob("*.json")}
    result = study(folder, "--workers", "0", *fewer)
    assert result.exit_code == 0, result.output
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    ours, theirs = results(folder), results(whole)
    assert 3 <= len(kept) < len(ours) == 32
    assert ours == {name: theirs[name] for name in ours}
    assert not list((folder / "runs").glob("*/checkpoint"))


def test_executors_give_the_same_results(whole: Path, tmp_path: Path) -> None:
    folder = tmp_path / "study"
    shutil.copytree(whole, folder)
    for condition in ("random", "privileged"):
        (folder / "results" / f"split-01.play.{condition}.json").unlink()
    (folder / "report.md").unlink()
    result = study(folder, "--executor", "dask", "--workers", "1")
    assert result.exit_code == 0, result.output
    assert results(folder) == results(whole)
    assert (folder / "report.md").is_file()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (("--folds", "3"), "belongs to another study"),
        (("--subset", "many"), "--subset many is not SIZE:SPLITS"),
        (("--subset", "4:1"), "a subset of 4 is not possible: a split trains on 3"),
        (("--scheduler", "tcp://somewhere:1"), "--scheduler needs --executor dask"),
        (("--where", "board.row=16"), "there is no axis 'board.row'; did you mean board.rows?"),
        (("--metric", "return", "--privileged-episodes", "0"), "--privileged-episodes must be 2 or more"),
    ],
)
def test_usage_errors(whole: Path, more: tuple[str, ...], words: str) -> None:
    result = study(whole, *more)
    assert result.exit_code == 2, result.output
    assert words in " ".join(result.output.split())


@pytest.mark.parametrize(("given", "wanted"), [((), PRESETS["laptop"].subsets), (("7:2",), ((7, 2),)), (("none",), ())])
def test_subsets_of_the_scale_can_be_replaced_or_omitted(given: tuple[str, ...], wanted: tuple[Any, ...]) -> None:
    options = dict.fromkeys((*commands._PROTOCOL, *commands._TRAINING))
    assert commands._protocol("laptop", given, (), options).subsets == wanted


@pytest.mark.parametrize(
    ("given", "wanted"),
    [((), PRESETS["laptop"].where), (("board.rows=16",), ("board.rows=16",)), (("none",), ())],
)
def test_axes_of_the_scale_can_be_replaced_or_freed(given: tuple[str, ...], wanted: tuple[str, ...]) -> None:
    options = dict.fromkeys((*commands._PROTOCOL, *commands._TRAINING))
    assert commands._protocol("laptop", (), given, options).where == wanted


def test_environments_of_a_study_share_the_given_axes(tmp_path: Path) -> None:
    root = selection.generate(tmp_path / "corpus", 3, 0, where=("board.columns=7", "board.wrap=true"))
    with Store(root) as store:
        boards = [row.origin["axes"]["board"] for row in environments.rows(store)]
    assert [(board["columns"], board["wrap"]) for board in boards] == [(7, True)] * 3


def test_study_without_online_steps(tmp_path: Path) -> None:
    fewer = ("--variants", "2", "--familiar", "0", "--privileged-episodes", "0", "--seeds", "1")
    result = study(tmp_path / "study", "--workers", "0", "--steps", "0", *fewer)
    assert result.exit_code == 0, result.output
    trained = [one for one in results(tmp_path / "study").values() if one["task"]["kind"] == "train"]
    assert {(one["task"]["condition"], one["updates"], one["steps"]) for one in trained} == {
        ("agent", 30, 0),
        ("without demonstrations", 0, 0),
    }


def test_folder_allows_one_study(whole: Path) -> None:
    with exclusive(whole):
        result = study(whole)
    assert result.exit_code == 2, result.output
    assert f"process {os.getpid()} is running in {whole}" in result.output


def test_usage_error_writes_nothing(tmp_path: Path) -> None:
    result = study(tmp_path / "study", "--folds", "99")
    assert result.exit_code == 2, result.output
    assert "cannot be split into 99 folds" in result.output
    assert not (tmp_path / "study").exists()
