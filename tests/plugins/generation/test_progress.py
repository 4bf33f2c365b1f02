"""The progress of a run, and the tables at its end."""

from __future__ import annotations

import io
from collections import Counter

import pytest
from envcraft_llm.endpoint.settings import ModelSettings
from envcraft_llm.endpoint.usage import UsageTracker
from envcraft_llm.pipeline.progress import ProgressDisplay
from envcraft_llm.pipeline.runner import RunProgress
from envcraft_llm.pipeline.tables import StageRow, stage_table, usage_lines, yield_lines
from rich.console import Console

ROWS = [StageRow("code", 4, 3, 0, 1, Counter({"no code": 1})), StageRow("validated", 3, 1, 2, 0, Counter())]


class Clock:
    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def accounts() -> UsageTracker:
    found = UsageTracker(ModelSettings())
    used = found.of("code")
    used.attempts, used.replayed, used.prompt_tokens, used.completion_tokens, used.cost = 5, 2, 4000, 2500, 0.75
    return found


def tally() -> RunProgress:
    found = RunProgress(total=20, settled=8, processed=4)
    found.outcomes = {("code", "passed"): 4, ("validated", "passed"): 2, ("validated", "rejected"): 1}
    found.in_stage = {"code": 3}
    return found


def test_on_a_terminal_a_table_is_drawn() -> None:
    clock, console = Clock(), Console(file=io.StringIO(), force_terminal=True, width=120)
    with ProgressDisplay(ROWS, tally(), accounts(), console, clock) as view:
        clock.seconds = 60.0
        view.update()
    assert isinstance(console.file, io.StringIO)
    said = console.file.getvalue()
    shown = {line.split()[0]: line.split()[1:] for line in said.splitlines() if line.startswith(("code", "valid"))}
    assert shown["code"] == ["8", "7", "1", "87.5%", "3"]
    assert shown["validated"] == ["6", "3", "3", "50.0%"]
    for words in ("8 of 20 settled", "tokens/s", "cost 0.75", "120 validated/h", "about 3 min left"):
        assert words in said


def test_redraws_are_rate_limited() -> None:
    clock, console = Clock(), Console(file=io.StringIO(), force_terminal=True, width=120)
    with ProgressDisplay(ROWS, tally(), None, console, clock) as view:
        for step in range(100):
            clock.seconds = step / 100
            view.update()
        assert isinstance(console.file, io.StringIO)
        assert console.file.getvalue().count("validated") == 1


def test_lines_are_printed_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    with ProgressDisplay(ROWS, tally(), None, None, clock) as view:
        for second in range(35):
            clock.seconds = float(second)
            view.update()
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert lines[0].startswith("code 7/8, validated 3/6, 8 of 20 settled, 480 validated/h, about 45 s left")


def test_the_first_judging_error_is_printed_once(capsys: pytest.CaptureFixture[str]) -> None:
    so_far = tally()
    with ProgressDisplay(ROWS, so_far, None, None, Clock()) as view:
        view.update()
        assert capsys.readouterr().err == ""
        for reason in ("pygame is not installed", "nor is this"):
            so_far.errors.append(reason)
            view.update()
    assert capsys.readouterr().err == "pygame is not installed\n"


def test_the_overall_row_omits_concepts_in_progress() -> None:
    """Three of ten concepts are in progress, one of them between stages."""
    ended = [
        StageRow("a", 10, 9, 1, 0, Counter()),
        StageRow("b", 7, 6, 0, 1, Counter()),
        StageRow("c", 5, 5, 0, 0, Counter()),
    ]
    assert stage_table(ended)[-1].startswith("| all | 7 | 5 | | | 71.4%")
    assert stage_table([*ended[:2], StageRow("c", 0, 0, 0, 0, Counter())])[-1].startswith("| c |")
    rejected = [
        StageRow("a", 2, 1, 1, 0, Counter()),
        StageRow("b", 1, 0, 1, 0, Counter()),
        StageRow("c", 0, 0, 0, 0, Counter()),
    ]
    assert stage_table(rejected)[-1].startswith("| all | 2 | 0 | | | 0.0%")


def test_the_table_of_stages() -> None:
    rows = [
        StageRow("a", 10, 9, 1, 0, Counter({"x": 1})),
        StageRow("b", 9, 0, 9, 0, Counter({"y": 5, "z": 4})),
        StageRow("c", 0, 0, 0, 0, Counter()),
    ]
    lines = stage_table(rows)
    assert "| b | 9 | 0 | 9 | 0 | 0.0% (0.0% to 29.9%) | y 5, z 4 |" in lines
    assert "| c | 0 | 0 | 0 | 0 | - |  |" in lines


def test_the_yields_of_attempts() -> None:
    assert yield_lines([(4, 3), (0, 0), (1, 0)]) == [
        "first: 3 of 4 (75.0%) without a finding",
        "repair 2: 0 of 1 (0.0%) without a finding",
    ]


def test_usage_lines() -> None:
    assert usage_lines(None) == []
    assert usage_lines(accounts()) == [
        "code: 5 sent, 2 replayed, 4,000 + 2,500 tokens, cost 0.75",
        "all: 5 sent, 2 replayed, 4,000 + 2,500 tokens, cost 0.75",
    ]
