"""The report for people: what it says, at any width, with and without colour."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from envcraft.judging.check import Rule
from envcraft.model.events import Finished, SubjectFinished, SubjectStarted
from envcraft.model.verdict import (
    CheckReport,
    Finding,
    Report,
    Repro,
    SandboxReport,
    Severity,
    SubjectReport,
    Verdict,
)
from envcraft.reports.console import ConsoleReporter

RULES = {
    "EC203": Rule(
        "EC203", "hash-seed", "It depends.", "Sort sets before iterating over them, wherever the order shows."
    ),
    "EC209": Rule("EC209", "same-seeds", "Same.", "Use np_random.", Severity.WARNING),
}
LONG = "seed 0 gives another trace under another PYTHONHASHSEED: the observation differs at step 12, and stays so"


def report(message: str = LONG) -> Report:
    repro = Repro(0, [[0, 0, 0]] * 12, {"hash_seed": 1, "fresh": True})
    checks = [
        CheckReport("source", Verdict.PASS, 0.1),
        CheckReport(
            "determinism",
            Verdict.FAIL,
            0.4,
            [Finding("EC203", Severity.ERROR, message, 41, {}, repro), Finding("EC209", Severity.WARNING, "same")],
        ),
        CheckReport("difficulty", Verdict.SKIP, 0.0, [], "the budget settled nothing"),
    ]
    good = SubjectReport("good.py", "Good", "0" * 64, Verdict.PASS, "container", 1.0, 20480, checks[:1], "docker")
    bad = SubjectReport("games/bad.py", "Bad", "0" * 64, Verdict.FAIL, "process", 1.0, 1, checks, "process")
    bad.sandbox = SandboxReport("process", ["rlimits"], ["Landlock", "system call \x1b[2Jfilter"])
    return Report("arcade", 3, [good, bad])


def rendered(report: Report, width: int | None = None, **settings: object) -> str:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    console = None
    if width is not None:
        console = Console(file=stream, width=width, highlight=False, markup=False, emoji=False, **settings)  # type: ignore[arg-type]
    reporter = ConsoleReporter(stream, RULES, console)
    for subject in report.reports:
        reporter.handle(SubjectFinished(subject))
    reporter.handle(Finished(report))
    stream.seek(0)
    return stream.read()


def test_everything_is_said_in_plain_text() -> None:
    text = rendered(report())
    assert "\x1b" not in text
    for words in (
        "PASS",
        "FAIL",
        "games/bad.py:41",
        "EC203 hash-seed",
        LONG,
        "Sort sets before",
        "(warning)",
        "20,480 steps",
        "1 step\n",
        "container isolation by docker",
        "missing protections on this machine: Landlock; system call \N{REPLACEMENT CHARACTER}[2Jfilter",
        "#1: seed 0, 12 actions, hash_seed 1, fresh worker",
        "#2: ",
        "difficulty",
        "the budget settled nothing",
        "1 passed, 1 failed",
        "1 finding, 1 warning ",
        "seed 3",
        "envcraft replay",
    ):
        assert words in text, words
    assert text.count("missing protections") == 1
    assert not [line for line in text.splitlines() if line != line.rstrip()]


@pytest.mark.parametrize("width", [60, 80, 120])
def test_lines_fit_a_terminal(width: int) -> None:
    text = rendered(report(), width, force_terminal=True, no_color=True, color_system=None)
    assert max(map(len, text.splitlines())) <= width
    assert " ".join(LONG.split()) in " ".join(text.split())


def test_colour_only_on_a_terminal_that_wants_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "\x1b[" in rendered(report(), 80, force_terminal=True, color_system="truecolor")
    monkeypatch.setenv("NO_COLOR", "1")
    text = rendered(report(), 80, force_terminal=True, color_system="truecolor")
    assert "31m" not in text
    assert "FAIL" in text


def test_an_environments_words_cannot_steer_the_terminal() -> None:
    text = rendered(report("boom \x1b[2J\x1b]0;title\x07 [red]x[/red] \u202egnp \x9b2J\rPASS"))
    assert not {"\x1b", "\x07", "\u202e", "\x9b", "\r"} & set(text)
    assert "[red]x[/red]" in text


def test_terminals_without_unicode_get_words() -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    reporter = ConsoleReporter(stream, RULES)
    for subject in report().reports:
        reporter.handle(SubjectFinished(subject))
    reporter.handle(Finished(report()))
    stream.seek(0)
    assert "fail  determinism" in stream.read()


def test_the_end_of_what_was_printed_is_shown_with_the_finding() -> None:
    made = report()
    found = made.reports[1].checks[1].findings
    output = "\n".join([*(f"line {number}" for number in range(9)), "", "\x1b[2Jlast " + "x" * 999])
    found[0] = Finding("EC203", Severity.ERROR, "it died", evidence={"output": output})
    said = rendered(made)
    assert "printed: line 7\n" in said
    assert "line 6" not in said
    assert "\x1b" not in said
    assert max(map(len, said.splitlines())) < 250


@pytest.mark.parametrize("width", [40, 60, 80])
def test_a_narrow_terminal_shows_the_line_of_a_traceback_that_raised(width: int) -> None:
    made = report()
    found = made.reports[1].checks[1].findings
    evidence = {"traceback": "\n".join([*(f"frame {number}" for number in range(5)), "KeyError: 1"]), "output": "x\ny"}
    found[0] = Finding("EC203", Severity.ERROR, LONG, 41, evidence)
    said = [line.strip() for line in rendered(made, width, force_terminal=True, color_system=None).splitlines()]
    assert "KeyError: 1" in said
    assert "frame 0" not in said


def test_subjects_are_shown_in_the_order_of_the_report() -> None:
    made = report()
    stream = io.StringIO()
    reporter = ConsoleReporter(stream, RULES)
    for number, subject in enumerate(made.reports, 1):
        reporter.handle(SubjectStarted(subject.path, number, 2))
    reporter.handle(SubjectFinished(made.reports[1]))
    assert stream.getvalue() == ""
    reporter.handle(SubjectFinished(made.reports[0]))
    assert stream.getvalue().index("good.py") < stream.getvalue().index("bad.py")
