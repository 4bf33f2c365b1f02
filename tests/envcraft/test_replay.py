"""``envcraft replay``: findings are reproduced, and an invalid report is a usage error of one line."""

from __future__ import annotations

import contextlib
import errno
import json
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def report(invoke: Any, good: Path, tmp_path: Path) -> Path:
    """A report with one finding that needs steps (a NaN reward), on a file of a relative path."""
    text = good.read_text().replace("float(won), won,", "float(won) if self.x < 7 else float('nan'), won,")
    (tmp_path / "nan.py").write_text(text)
    checks = ("--checks", "reward", "--sandbox", "process", "--budget", "quick")
    result = invoke("validate", "nan.py", *checks, "--format", "json", "--output", "report.json")
    assert result.exit_code == 1
    return tmp_path / "report.json"


def test_findings_show_again(invoke: Any, report: Path) -> None:
    result = invoke("replay", report, "--sandbox", "process")
    assert result.exit_code == 0
    assert result.stdout.startswith("#1 EC301 nan.py")
    assert ": reproduced: " in result.stdout


def test_relative_paths_also_count_from_the_report(
    invoke: Any, report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert invoke("replay", report, "--sandbox", "process").exit_code == 0


def test_a_mended_environment_does_not_show_it(invoke: Any, report: Path, good: Path, tmp_path: Path) -> None:
    (tmp_path / "nan.py").write_bytes(good.read_bytes())
    result = invoke("replay", report, "--sandbox", "process")
    assert result.exit_code == 3
    assert "has changed since the report" in result.stdout
    result = invoke("replay", report, "--sandbox", "process", "--anyway")
    assert result.exit_code == 1
    assert ": not reproduced: " in result.stdout


def test_a_missing_environment_could_not_be_replayed(invoke: Any, report: Path, tmp_path: Path) -> None:
    (tmp_path / "nan.py").unlink()
    result = invoke("replay", report, "--sandbox", "process")
    assert result.exit_code == 3
    assert "could not be replayed: nan.py cannot be read" in result.stdout


def test_gif_shows_the_reproduction(invoke: Any, report: Path, tmp_path: Path) -> None:
    from PIL import Image

    result = invoke("replay", report, "--finding", 1, "--gif", "finding.gif", "--sandbox", "process")
    assert result.exit_code == 0
    actions = json.loads(report.read_text())["reports"][0]["checks"][1]["findings"][0]["repro"]["actions"]
    with Image.open(tmp_path / "finding.gif") as picture:
        assert picture.size == (336, 336)
        # Pillow joins frames that are alike, which this game has when it stands still.
        assert 2 <= getattr(picture, "n_frames", 1) <= len(actions) + 1


def test_a_full_disk_keeps_the_earlier_gif(
    invoke: Any, report: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    def save(self: Image.Image, file: Any, **options: Any) -> None:
        with open(file, "wb") if isinstance(file, str) else contextlib.nullcontext(file) as stream:
            stream.write(b"GIF89a")
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Image.Image, "save", save)
    assert report.exists()
    (tmp_path / "finding.gif").write_text("earlier")
    before = {*tmp_path.iterdir()}
    result = invoke("replay", "nan.py", "--repro", '{"seed": 0}', "--gif", "finding.gif", "--sandbox", "process")
    assert result.exit_code == 3
    assert "--gif finding.gif cannot be written: No space left on device" in result.stderr
    assert (tmp_path / "finding.gif").read_text() == "earlier"
    assert {*tmp_path.iterdir()} == before


@pytest.mark.parametrize("name", ["finding.png", "nan.py", "finding.mp4"])
def test_a_gif_of_another_name_is_wrong_use(name: str, invoke: Any, report: Path, tmp_path: Path) -> None:
    assert report.exists()
    before = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    result = invoke("replay", "nan.py", "--repro", '{"seed": 0}', "--gif", name, "--sandbox", "process")
    assert result.exit_code == 2
    assert result.stderr == f"Error: --gif {name} is an animated GIF; end its name with .gif\n"
    assert {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--repro", '{"sed": 1}'], "--repro has no field 'sed'; did you mean seed?"),
        (
            ["--repro", '{"conditions": {"hash_sed": 1}}'],
            "--repro has no condition 'hash_sed'; did you mean hash_seed?",
        ),
        ([], "nan.py is not a report but a Python file; write one with"),
    ],
)
def test_what_is_no_reproduction_says_so(arguments: list[str], words: str, invoke: Any, report: Path) -> None:
    assert report.exists()
    result = invoke("replay", "nan.py", *arguments, "--sandbox", "process")
    assert result.exit_code == 2
    assert words in result.stderr


def test_one_frame_is_a_frame(invoke: Any, report: Path) -> None:
    assert report.exists()
    result = invoke("replay", "nan.py", "--repro", '{"seed": 0}', "--gif", "start.gif", "--sandbox", "process")
    assert "wrote start.gif: 1 frame\n" in result.stderr
    result = invoke("replay", "nan.py", "--repro", '{"seed": 0, "actions": [[0, 0, 0]]}', "--sandbox", "process")
    assert result.stdout.endswith("return 0, 1 step\n")


def test_numbers_beyond_the_report(invoke: Any, report: Path) -> None:
    result = invoke("replay", report, "--finding", 2)
    assert result.exit_code == 2
    assert "there is no finding 2: the report has 1" in result.stderr


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not a report"),
        (b"\xff\xfe", "is not a report"),
        (b"[" * 100_000, "is not a report"),
        (b"{}", "is not a report"),
        (b'{"contract": "arcade", "seed": 0, "reports": [], "schema": 2}', "schema 2"),
        (b'{"contract": "arcade", "seed": "x", "reports": []}', "is not a report"),
        (None, "cannot be read"),
    ],
)
def test_what_is_no_report_is_a_sentence(invoke: Any, tmp_path: Path, content: bytes | None, words: str) -> None:
    if content is not None:
        (tmp_path / "odd.json").write_bytes(content)
    result = invoke("replay", "odd.json")
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("change", [{"seed": -1}, {"seed": 2**63}, {"actions": [0] * 100_001}])
def test_reproductions_are_bounded(invoke: Any, report: Path, change: dict[str, Any]) -> None:
    data = json.loads(report.read_text())
    data["reports"][0]["checks"][1]["findings"][0]["repro"].update(change)
    report.write_text(json.dumps(data))
    result = invoke("replay", report)
    assert result.exit_code == 2
    assert "invalid seed or too many actions" in result.stderr


def test_a_report_without_findings(invoke: Any, tmp_path: Path) -> None:
    (tmp_path / "clean.json").write_text('{"contract": "arcade", "seed": 0, "reports": []}')
    result = invoke("replay", "clean.json")
    assert result.exit_code == 0
    assert "no finding" in result.stdout
