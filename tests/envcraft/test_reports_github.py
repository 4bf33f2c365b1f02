"""Workflow commands: read back as the runner reads them, and nothing that an environment says becomes one."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import assume, given, settings

from envcraft.model.verdict import Report, Verdict
from envcraft.reports.github import GitHubReporter
from envcraft.text import one_line
from tests.envcraft.report_samples import MESSAGE, REPORTS, RULES, hostile, rendered, sample, subject


def commands(report: Report, encoding: str = "utf-8") -> list[tuple[str, dict[str, str], str]]:
    """Every line's command, properties and message, by the rules of the runner's parser."""
    found = []
    text = rendered(GitHubReporter, report, encoding)
    assert text.endswith("\n")
    # The runner ends a line at either character.
    for line in text[:-1].replace("\r", "\n").split("\n"):
        assert line.startswith("::"), line
        head, message = line[2:].split("::", 1)
        name, _, given = head.partition(" ")
        pairs = dict(pair.split("=", 1) for pair in given.split(",") if pair)
        found.append((name, {key: _property(value) for key, value in pairs.items()}, _data(message)))
    return found


def _data(text: str) -> str:
    return text.replace("%0D", "\r").replace("%0A", "\n").replace("%25", "%")


def _property(text: str) -> str:
    return _data(text.replace("%3A", ":").replace("%2C", ","))


def test_findings_are_annotations() -> None:
    same, first, second, order, warned, lost, summary = commands(sample())
    assert order[:2] == ("error", {"file": "games/bad game.py", "line": "41", "title": "EnvCraft EC203 hash-seed"})
    assert order[2] == f"{MESSAGE}\nFix: Sort sets before iterating over them.\nMore: envcraft explain EC203"
    assert first == second
    assert same[:2] == ("warning", {"file": "good.py", "title": "EnvCraft EC209 same-seeds"})
    assert warned[0] == "warning"
    assert lost[:2] == ("error", {"file": "lost.py", "title": "EnvCraft: api could not judge"})
    assert lost[2] == "the worker stopped answering"
    assert summary[:2] == ("notice", {"title": "EnvCraft"})
    assert summary[2] == (
        "1 passed, 1 failed, 0 undecided, 1 could not be judged: 3 findings, 2 warnings (contract arcade)\n"
        "Not in force on this machine: Landlock"
    )


def test_a_subject_lost_before_any_check_is_an_error() -> None:
    alone = subject("a.py", [], reason="the pool is gone")
    alone.verdict = Verdict.ERROR
    found = commands(Report("arcade", 0, [alone]))[0]
    assert found == ("error", {"file": "a.py", "title": "EnvCraft: could not be judged"}, "the pool is gone")


def test_paths_count_from_the_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    games = tmp_path / "games"
    games.mkdir()
    monkeypatch.chdir(games)
    report = sample()
    monkeypatch.delenv("GITHUB_WORKSPACE", raising=False)
    assert commands(report)[0][1]["file"] == "good.py"
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))
    assert commands(report)[0][1]["file"] == "games/good.py"
    report.reports[0].path = str(tmp_path / "a,b:c.py")
    assert commands(report)[0][1]["file"] == "a,b:c.py"


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_hostile_words_are_no_commands(encoding: str) -> None:
    report = hostile()
    found = commands(report, encoding)
    assert {name for name, _, _ in found} == {"error", "warning", "notice"}
    assert len(found) == 3 * len(report.reports) + 1
    assert all(set(given) <= {"file", "line", "title"} for _, given, _ in found)


@settings(deadline=None, max_examples=100)
@given(REPORTS)
def test_any_message_comes_through(report: Report) -> None:
    # No file has a name of blanks alone.
    assume(all(one_line(judged.path) for judged in report.reports))
    found = iter(commands(report))
    for judged in report.reports:
        for check in judged.checks:
            for finding in check.findings:
                name, given, message = next(found)
                assert name == finding.severity.value
                empty = "" if finding.code in RULES else "no message"
                assert message.split("\nFix: ")[0] == (one_line(finding.message) or empty)
                assert given.get("line") == (str(finding.line) if finding.line else None)
            if check.verdict is Verdict.ERROR:
                next(found)
        if judged.verdict is Verdict.ERROR and not [c for c in judged.checks if c.verdict is Verdict.ERROR]:
            next(found)
    assert next(found)[0] == "notice"
    assert not list(found)
