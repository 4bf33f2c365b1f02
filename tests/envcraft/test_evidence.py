"""What a finding is shown with: on the console, with pytest's words, and at the top of the HTML report."""

from __future__ import annotations

import hashlib
import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from envcraft.contracts.lookup import contract_named
from envcraft.judging.budget import BUDGETS
from envcraft.judging.driver import driver_for
from envcraft.judging.engine import Plan
from envcraft.judging.frame_renderer import FrameRenderer, png
from envcraft.judging.selection import default_checks, driver_named
from envcraft.model.frame import Frame
from envcraft.model.target import Kind, read_target
from envcraft.model.verdict import CheckReport, Finding, Report, Repro, Severity, SubjectReport, Verdict
from envcraft.reports.console import ConsoleReporter
from envcraft.reports.evidence import lines_below, source_line
from envcraft.reports.html import HtmlReporter
from envcraft.reports.pictures import picture_lines, shows_pictures
from tests.envcraft.conftest import ENVIRONMENT
from tests.envcraft.report_samples import RULES, events, rendered, sample

TRACEBACK = (
    "".join(f'  File "walk.py", line {line}, in step\n    call_{line}()\n' for line in range(20)) + "KeyError: 7\n"
)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "walk.py"
    path.write_text(ENVIRONMENT)
    return path


def judged(path: Path, finding: Finding) -> SubjectReport:
    checks = [CheckReport("determinism", Verdict.FAIL, 0.1, [finding])]
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    return SubjectReport(str(path), "Walk", sha256, Verdict.FAIL, "process", 1.0, 9, checks)


def said(report: SubjectReport, verbosity: int = 0, width: int | None = None) -> list[str]:
    stream = io.StringIO()
    console = width and Console(file=stream, width=width, force_terminal=True, color_system=None, markup=False)
    reporter = ConsoleReporter(stream, RULES, console or None)
    reporter.verbosity = verbosity
    for event in events(Report("arcade", 0, [report])):
        reporter.handle(event)
    lines = [line.rstrip() for line in stream.getvalue().splitlines()]
    start = next(number for number, line in enumerate(lines) if line.lstrip().startswith("EC203"))
    return [line.strip() for line in lines[start : lines.index("", start)]]


def test_an_installed_class_has_its_source_line_where_its_file_is_the_same(file: Path) -> None:
    # A text of this test only: a source that another test gives as a text is kept for the whole process.
    file.write_text(f"{ENVIRONMENT}\n# {file}\n")
    finding = Finding("EC204", Severity.ERROR, "differs", 1)
    report = judged(file, finding)
    report.path, report.kind, report.module, report.source_file = "walk:Walk", Kind.MODULE, "walk", str(file)
    assert source_line(report, finding) == ENVIRONMENT.splitlines()[0]
    report.source_file = str(file.rename(file.with_suffix(".txt")))
    assert not source_line(report, finding)
    file.write_text(ENVIRONMENT)
    report.source_file = str(file)
    assert not source_line(report, finding)


def test_the_source_line_and_the_differing_values(file: Path) -> None:
    number = 1 + ENVIRONMENT.splitlines().index("        self.steps += 1")
    finding = Finding("EC203", Severity.ERROR, "it differs", number, {"step": 3, "first": 0.5, "second": [1, 2]})
    assert said(judged(file, finding)) == [
        f"EC203 hash-seed {file}:{number}",
        "it differs",
        f"{number} | self.steps += 1",
        "expected: 0.5",
        "found: [1, 2]",
        "fix: Sort sets before iterating over them.",
        "#1: seed 0, no action",
    ]


def test_a_line_of_a_file_that_has_changed_is_not_shown(file: Path) -> None:
    finding = Finding("EC203", Severity.ERROR, "it differs", 2)
    report = judged(file, finding)
    assert source_line(report, Finding("EC203", Severity.ERROR, "", 1)) == ENVIRONMENT.splitlines()[0]
    for line in (None, 0, 999):
        assert source_line(report, Finding("EC203", Severity.ERROR, "", line)) == ""
    file.write_text("# another\n" + ENVIRONMENT)
    assert source_line(report, finding) == ""
    file.unlink()
    assert source_line(report, finding) == ""


@pytest.mark.parametrize("width", [None, 60, 100])
def test_a_finding_takes_at_most_twelve_lines(file: Path, width: int | None) -> None:
    evidence = {"first": "a" * 500, "second": "b" * 500, "traceback": TRACEBACK, "output": "one\ntwo\nthree\nfour\n"}
    report = judged(file, Finding("EC203", Severity.ERROR, "it differs", 5, evidence))
    short, everything = said(report, width=width), said(report, 1, width)
    assert len(short) == 12
    assert any(line.startswith("--verbose shows ") and line.endswith(" more lines") for line in short)
    assert short[-1] == "#1: seed 0, no action"
    assert any(line.startswith("fix: ") for line in short)
    assert len(everything) > 45
    assert "call_0()" in everything
    assert "KeyError: 7" in everything
    assert "printed: one" in everything


@pytest.mark.parametrize("width", [30, 40, 50, 60])
def test_a_narrow_terminal_shows_the_values_and_the_line_from_its_code_on(
    width: int, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(file.parent)
    number = 1 + ENVIRONMENT.splitlines().index("        self.steps += 1")
    evidence = {"first": [1, 2], "second": [1, 3], "output": "one\ntwo\nthree\n"}
    finding = Finding("EC203", Severity.ERROR, "the observation differs " * 16, number, evidence)
    lines = said(judged(Path(file.name), finding), width=width)
    assert len(lines) == 12
    assert max(map(len, lines)) <= width - 4
    assert lines[0].startswith("EC203")
    assert {f"{number} | self.steps += 1", "expected: [1, 2]", "found: [1, 3]"} <= set(lines)
    assert any(line.endswith(("the…", "observation…", "differs…")) for line in lines)


@pytest.mark.parametrize("words", ["it differs", "it differs " * 60], ids=["short", "long"])
def test_a_narrow_terminal_says_that_lines_are_hidden(words: str, file: Path) -> None:
    finding = Finding("EC203", Severity.ERROR, words, 5, {"traceback": TRACEBACK, "output": "one\ntwo\nthree\nfour\n"})
    lines = said(judged(file, finding), width=40)
    [hint] = [line for line in lines if line.startswith("--verbose shows ")]
    assert hint.endswith(" more lines")
    assert lines[-1].startswith("#1: ")


def test_the_end_of_the_traceback_is_shown(file: Path) -> None:
    finding = Finding("EC203", Severity.ERROR, "step 3 raises", 5, {"traceback": TRACEBACK})
    lines = said(judged(file, finding))
    assert lines[lines.index("KeyError: 7") - 1] == "call_19()"
    assert "call_0()" not in lines


@pytest.mark.parametrize("width", [None, 40])
def test_the_last_line_of_the_project_stays_beside_what_raised(file: Path, width: int | None) -> None:
    """Calls of libraries between the two give way first, however many there are."""
    library = "".join(
        f'  File "/lib/paths.py", line {line}, in read\n    read_{line}()\n    ^^^^\n' for line in range(7)
    )
    own = "".join(f'  File "{name}", line 3, in read\n    {name[0]}.load()\n' for name in ("walk.py", "base.py"))
    finding = Finding("EC203", Severity.ERROR, "it raises " * 20, 5, {"traceback": own + library})
    lines = said(judged(file, finding), width=width)
    assert {"b.load()", "read_6()"} <= set(lines)
    assert "w.load()" not in lines
    if width is None:
        assert 'File "base.py", line 3, in read' in lines
        assert {"b.load()", "read_6()"} <= {line.strip() for line in lines_below(judged(file, finding), finding)}


def test_evidence_cannot_steer_the_terminal(file: Path) -> None:
    hostile = "\x1b[2J\x9b2J\u202e\r[red]x[/red]\nEC999 forged"
    finding = Finding("EC203", Severity.ERROR, "x", 1, {"first": hostile, "traceback": hostile, hostile: hostile})
    file.write_text(f"# \x1b[2J {ENVIRONMENT}")
    text = "\n".join(said(judged(file, finding), 1))
    assert not {"\x1b", "\x9b", "\u202e", "\r"} & set(text)
    assert "[red]x[/red]" in text


#: A walk whose frame shows the order of a set of strings, which PYTHONHASHSEED decides.
HASHED = ENVIRONMENT.replace(
    "        frame[40:44, self.goal",
    """        frame[0, 0] = [len(name) * 9 for name in {'a', 'bb', 'ccc', 'dddd', 'eeeee'}][:3]
        frame[40:44, self.goal""",
)


def test_the_expected_frame_is_beside_the_one_that_differs(tmp_path: Path) -> None:
    path = tmp_path / "hashed.py"
    path.write_text(HASHED)
    target = read_target(str(path))
    driver = driver_for(driver_named("process"), [target])
    plan = Plan([target], contract_named("arcade"), driver, default_checks(), BUDGETS["quick"])
    repro = Repro(0, [[4, 0, 0]], {"fresh": True, "hash_seed": 20_241})
    report = judged(path, Finding("EC203", Severity.ERROR, "", None, {"first": None}, repro))
    with FrameRenderer(plan) as frames:
        for frame in frames(report, report.checks[0].findings[0]):
            assert frame.expected.startswith(b"\x89PNG")
            assert frame.expected != frame.png
        same = Finding("EC203", Severity.ERROR, "", None, {"first": None}, Repro(0, [[4, 0, 0]], {"heap": 1}))
        assert [frame.expected for frame in frames(report, same)] == [b"", b""]
    driver.close()


def test_the_page_opens_with_the_failures() -> None:
    def film(report: SubjectReport, finding: Finding) -> list[Frame]:
        return [Frame(0, b"one"), Frame(1, b"two", b"three" if finding.code == "EC203" else b"")]

    page = rendered(HtmlReporter, sample(), frames=film)
    top = page[page.index('<nav class="failures"') : page.index("</nav>")]
    assert page.index("</nav>") < page.index('<details class="subject"')
    # In the order of the report, errors only, each with a link to all about it.
    links = [part.partition('"')[0] for part in top.split('<a href="#')[1:]]
    assert links == ["finding-2", "finding-3", "finding-4"]
    assert all(f'id="{link}"' in page for link in links)
    # "two" was found, and "three" is expected.
    assert (top.count("base64,dHdv"), top.count("base64,dGhyZWU=")) == (3, 1)
    assert '<nav class="failures"' not in rendered(HtmlReporter, Report("arcade", 0, sample().reports[:1]))


class _Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


_TRUECOLOR = {"COLORTERM": "truecolor", "TERM": "xterm", "NO_COLOR": ""}


@pytest.mark.parametrize(
    ("changes", "field", "drawn"),
    [
        ({}, "observation", True),
        ({"NO_COLOR": "1"}, "observation", False),
        ({"COLORTERM": ""}, "observation", False),
        ({"TERM": "dumb"}, "observation", False),
        ({}, "reward", False),
    ],
)
def test_a_terminal_shows_both_frames_cut_to_the_difference(
    changes: dict[str, str], field: str, drawn: bool, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {**_TRUECOLOR, **changes}.items():
        monkeypatch.setenv(name, value)
    stream = _Terminal()
    reporter = ConsoleReporter(stream, RULES)
    expected = np.zeros((84, 84, 3), np.uint8)
    frame = expected.copy()
    frame[80:, 40] = 1, 2, 3
    if reporter.wants_frames:
        reporter.frames = lambda *_: [Frame(0, b""), Frame(3, png(frame), png(expected))]
    finding = Finding("EC203", Severity.ERROR, "it differs", None, {"field": field})
    for event in events(Report("arcade", 0, [judged(file, finding)])):
        reporter.handle(event)
    rows = [line for line in stream.getvalue().splitlines() if "▀" in line]
    # The last four of the twelve rows of pixels differ, and two are one line.
    assert [row.count("▀") for row in rows] == [24] * 6 * drawn
    assert [("1;2;3" in row) for row in rows] == [False, False, False, False, True, True][: len(rows)]


def test_no_stream_but_a_terminal_shows_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in _TRUECOLOR.items():
        monkeypatch.setenv(name, value)
    assert not shows_pictures(io.StringIO())


@pytest.mark.parametrize(
    ("lines", "width", "shape"), [(6, 80, (6, 12)), (6, 5, (2, 5)), (0, 80, (0, 0)), (3, 0, (0, 0))]
)
def test_a_picture_fits_its_room(lines: int, width: int, shape: tuple[int, int]) -> None:
    rows = picture_lines(Frame(0, png(np.zeros((84, 84, 3), np.uint8))), lines, width)
    assert (len(rows), len(rows[0].plain) if rows else 0) == shape
