"""Findings about an installed environment name lines of its module, and no file of the repository."""

from __future__ import annotations

import hashlib
import json
import shlex
from pathlib import Path

import msgspec
import pytest

from envcraft.model.target import Kind
from envcraft.model.verdict import CheckReport, Finding, Report, Severity, Verdict
from envcraft.reports.console import ConsoleReporter
from envcraft.reports.github import GitHubReporter
from envcraft.reports.html import HtmlReporter
from envcraft.reports.junit import JUnitReporter
from envcraft.reports.markdown import MarkdownReporter
from envcraft.reports.reporter import Reporter
from envcraft.reports.sarif import SarifReporter
from envcraft.reports.summary import numbered, replay_command
from tests.envcraft.report_samples import rendered, subject

FINDING = Finding("EC107", Severity.ERROR, "step 155 raises IndexError", 91)
REPORT = Report(
    "gymnasium",
    0,
    [
        subject(
            "Maze-v1",
            [CheckReport("api", Verdict.FAIL, 0.1, [FINDING])],
            kind=Kind.ID,
            module="mazes.envs",
            kwargs={"size": 8},
            wrappers=["mazes.wrap:Flat"],
        )
    ],
)


@pytest.mark.parametrize("kind", [ConsoleReporter, GitHubReporter, HtmlReporter, JUnitReporter, MarkdownReporter])
def test_a_line_is_one_of_the_module(kind: type[Reporter]) -> None:
    text = rendered(kind, REPORT)
    assert "mazes.envs:91" in text
    assert "Maze-v1:91" not in text


def test_the_file_of_the_module_is_named_with_the_line() -> None:
    report = msgspec.structs.replace(REPORT.reports[0], source_file="lib/mazes/envs.py")
    text = rendered(ConsoleReporter, msgspec.structs.replace(REPORT, reports=[report]))
    assert "EC107" in text
    assert "lib/mazes/envs.py:91" in text
    assert "mazes.envs.Game" in text


def test_no_file_of_the_repository_is_annotated() -> None:
    assert "file=" not in rendered(GitHubReporter, REPORT)


def test_sarif_names_the_class_and_no_line() -> None:
    [result] = json.loads(rendered(SarifReporter, REPORT))["runs"][0]["results"]
    [location] = result["locations"]
    assert location["logicalLocations"] == [{"fullyQualifiedName": "mazes.envs.Game"}]
    assert "region" not in location["physicalLocation"]


@pytest.mark.parametrize(("more", "option"), [("", False), ("class Tile: ...\n", True), ("Env = Game\n", True)])
def test_the_command_names_the_class_of_a_file_with_others(more: str, option: bool, tmp_path: Path) -> None:
    file = tmp_path / "game.py"
    file.write_text(f"class Game: ...\n{more}")
    sha256 = hashlib.sha256(file.read_bytes()).hexdigest()
    name = "Env" if "Env" in more else "Game"
    judged = subject(str(file), REPORT.reports[0].checks, env_class=name)
    judged = msgspec.structs.replace(judged, source_sha256=sha256)
    [item] = numbered(Report("arcade", 0, [judged]))
    assert (f" --class {name} " in replay_command(Report("arcade", 0, [judged]), item)) is option


def test_the_command_gives_the_same_arguments() -> None:
    [item] = numbered(REPORT)
    words = shlex.split(replay_command(REPORT, item).splitlines()[0])
    assert json.loads(words[words.index("--kwargs") + 1]) == {"size": 8}
    assert words[words.index("--wrap") + 1] == "mazes.wrap:Flat"
    assert words[words.index("--checks") + 1] == "api"
