"""The progress on stderr: the content of the view, when it is hidden, and the lines without a terminal."""

from __future__ import annotations

import fcntl
import io
import json
import os
import pty
import re
import select
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from rich.cells import cell_len
from rich.console import Console

from envcraft.cli.progress import Progress, Tally, left_words, line, shortened, speed_words, view
from envcraft.model.events import (
    CheckFinished,
    CheckStarted,
    Event,
    Finished,
    StepsTaken,
    SubjectFinished,
    SubjectStarted,
)
from envcraft.model.verdict import CheckReport, Report, SubjectReport, Verdict
from envcraft.reports.console import SIGNS

HIDE, SHOW = "\x1b[?25l", "\x1b[?25h"
COLOUR = re.compile(r"\x1b\[[0-9;]*3[0-7]m")
HOSTILE = "games/\x1b[2J\x1b]0;title\x07\u202e[red]\r\n" + "日本語" * 20 + ".py"


class Clock:
    """Seconds that only the test lets pass."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def finished(path: str, verdict: Verdict = Verdict.PASS, steps: int = 0) -> SubjectFinished:
    return SubjectFinished(SubjectReport(path, None, "", verdict, "process", 1.0, steps, []))


def settled(path: str, check: str, verdict: Verdict = Verdict.PASS) -> list[Event]:
    return [CheckStarted(path, check), CheckFinished(path, CheckReport(check, verdict))]


def terminal(stream: io.StringIO | None = None, width: int = 80, height: int = 25) -> Console:
    return Console(
        file=stream or io.StringIO(), force_terminal=True, width=width, height=height, color_system="standard"
    )


def tally_of(events: Iterable[Event], clock: Callable[[], float] | None = None) -> Tally:
    tally = Tally(clock or Clock())
    for event in events:
        tally.take(event)
    return tally


def several(paths: Iterable[str], total: int = 40) -> list[Event]:
    events: list[Event] = []
    for number, path in enumerate(paths, 1):
        events.append(SubjectStarted(path, number, total))
        events += settled(path, "source") + settled(path, "api", Verdict.FAIL)
        events += settled(path, "reward", Verdict.SKIP) + settled(path, "observation", Verdict.ERROR)
        events += [CheckStarted(path, "determinism"), StepsTaken(path, 12345)]
    return events


def test_a_row_for_each_subject_and_the_counts() -> None:
    clock = Clock()
    tally = tally_of([*several(["a.py", "games/b.py", "c.py"]), finished("c.py", Verdict.FAIL, 5000)], clock)
    clock.now = 10.0
    assert view(tally, 80, 25, SIGNS).plain.splitlines() == [
        "a.py        ✓✗-!…  determinism  12,345 steps  1,230 steps/s",
        "games/b.py  ✓✗-!…  determinism  12,345 steps  1,230 steps/s",
        "1 of 40 judged · 1 failed · 2,970 steps/s",
    ]


def test_one_subject_alone_shows_the_names_of_its_checks() -> None:
    clock = Clock()
    tally = tally_of(several(["games/snake.py"], 1), clock)
    clock.now = 5.0
    assert view(tally, 50, 25, SIGNS).plain.splitlines() == [
        "games/snake.py  12,345 steps, 2,470 steps/s, 5 s",
        "  ✓ source  ✗ api  - reward  ! observation",
        "  … determinism",
    ]


@pytest.mark.parametrize("total", [1, 40])
@pytest.mark.parametrize("width", [5, 17, 30, 60, 200])
@pytest.mark.parametrize("height", [2, 4, 25])
def test_a_frame_fits_the_terminal_and_names_cannot_steer_it(total: int, width: int, height: int) -> None:
    tally = tally_of(several([HOSTILE, *map(str, range(9))][:total], total))
    stream = io.StringIO()
    terminal(stream, width + 3, height).print(view(tally, width, height, SIGNS))
    shown = re.sub(r"\x1b\[[0-9;]*m", "", stream.getvalue())
    assert not {"\x1b", "\x07", "\u202e", "\r"} & set(shown)
    assert len(shown.splitlines()) <= height - 1
    assert max(map(cell_len, shown.splitlines())) <= width


def test_a_path_loses_its_middle() -> None:
    assert shortened("a/b.py", 20) == "a/b.py"
    assert (
        shortened("environments/generated/batch-17/snake_042.py", 24)
        == "environm…7/snake_042.py"[:8] + "…" + ("environments/generated/batch-17/snake_042.py"[-15:])
    )
    assert all(cell_len(shortened("日本語" * 20, width)) <= width for width in range(1, 40))


def test_nothing_is_estimated_before_there_is_something_to_tell_it_from() -> None:
    clock = Clock()
    tally = tally_of([SubjectStarted(f"{n}.py", n, 40) for n in range(1, 7)], clock)
    assert (tally.speed(), tally.left()) == (None, None)
    clock.now = 10.0
    for number in (1, 2):
        tally.take(finished(f"{number}.py", steps=50_000))
        tally.take(SubjectStarted(f"{number + 6}.py", number + 6, 40))
    assert tally.speed() == 10_000
    assert tally.left() is None
    for number in (3, 4, 5, 6):
        tally.take(finished(f"{number}.py", Verdict.FAIL))
    # Two more half done: seven in ten seconds, 33 to come.
    assert tally.left() == pytest.approx(33 / 7 * 10)
    assert line(tally) == "6 of 40 judged, 2 passed, 4 failed, 10,000 steps/s, about 45 s left"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (left_words(0.1), "about 5 s left"),
        (left_words(41), "about 40 s left"),
        (left_words(130), "about 2 min left"),
        (left_words(6000), "about 1.7 h left"),
        (speed_words(0.2), "under 1 step/s"),
        (speed_words(9.99), "10 steps/s"),
        (speed_words(18_234), "18,200 steps/s"),
    ],
)
def test_words(words: str, said: str) -> None:
    assert words == said


def canned(subjects: int, workers: int) -> Iterable[Event]:
    """Events of subjects that a number of workers judge in lockstep."""
    for first in range(1, subjects + 1, workers):
        paths = [f"games/game_{number:04}.py" for number in range(first, min(first + workers, subjects + 1))]
        yield from several(paths, subjects)
        yield from (finished(path, steps=20_000) for path in paths)
    yield Finished(Report("arcade", 0, []))


@pytest.mark.parametrize("output", [io.StringIO, Terminal])
def test_a_thousand_subjects_cost_little_and_show_what_is_under_way(output: Callable[[], io.StringIO]) -> None:
    stream, tally = io.StringIO(), Tally(Clock())
    most = 0
    began = time.process_time()
    with Progress(output(), terminal(stream)) as progress:
        for event in canned(1000, 8):
            progress.handle(event)
            tally.take(event)
            most = max(most, len(tally.rows))
    assert most == 8
    assert tally.done == 1000
    # About 12,000 events, and at the most a picture for each subject.
    assert time.process_time() - began < 10
    assert 0 < stream.getvalue().count(HIDE) == stream.getvalue().count(SHOW)


def test_the_view_gives_way_to_a_report_on_the_same_terminal_only() -> None:
    for output, ways in ((Terminal(), 4), (io.StringIO(), 1)):
        stream = io.StringIO()
        with Progress(output, terminal(stream)) as progress:
            for event in several(["a.py", "b.py", "c.py"]):
                progress.handle(event)
            for path in ("a.py", "b.py", "c.py"):
                progress.handle(finished(path))
                if output.isatty():
                    assert stream.getvalue().endswith("\x1b[1A\x1b[2K")
                progress.handle(StepsTaken("d.py", 1))
            progress.handle(Finished(Report("arcade", 0, [])))
        assert stream.getvalue().count(HIDE) == ways
        assert stream.getvalue().rindex(SHOW) > stream.getvalue().rindex(HIDE)


def test_an_interrupt_leaves_the_cursor_shown() -> None:
    stream = io.StringIO()

    def interrupted() -> None:
        with Progress(io.StringIO(), terminal(stream)) as progress:
            for event in several(["a.py"]):
                progress.handle(event)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert stream.getvalue().rindex(SHOW) > stream.getvalue().rindex(HIDE)


def test_lines_now_and_then_where_there_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")
    clock = Clock()
    with Progress(clock=clock) as progress:
        for event in canned(40, 4):
            clock.now += 0.2
            progress.handle(event)
    said = capsys.readouterr()
    assert said.out == ""
    lines = said.err.splitlines()
    # One in 15 of the 96 seconds.
    assert len(lines) == 6
    assert lines[0] == "4 of 40 judged, 4 passed, 6,980 steps/s, about 2 min left"
    assert lines[-1] == "36 of 40 judged, 36 passed, 8,120 steps/s, about 5 s left"


def test_what_is_only_played_has_not_passed() -> None:
    tally = Tally(Clock(), "played")
    for event in canned(40, 4):
        tally.take(event)
    assert line(tally).startswith(f"{tally.done} of 40 played")
    assert "passed" not in line(tally)


def test_a_single_subject_is_spoken_of_only_when_it_takes_long(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    with Progress(clock=clock) as progress:
        for event in several(["games/snake.py"], 1):
            progress.handle(event)
        assert capsys.readouterr().err == ""
        clock.now = 20.0
        progress.handle(StepsTaken("games/snake.py", 20_000))
        progress.handle(finished("games/snake.py"))
        progress.handle(Finished(Report("arcade", 0, [])))
    assert capsys.readouterr().err == "games/snake.py: determinism, 20,000 steps, 1,000 steps/s\n"


# The command on a terminal

ARGUMENTS = ("--sandbox", "process", "--budget", "quick", "--checks", "api,reward,observation")


def on_terminal(
    arguments: Iterable[str | Path],
    output: Path | None = None,
    until: str = "",
    environment: dict[str, str] | None = None,
    name: str = "validate",
) -> tuple[str, int]:
    """What the command of a name writes on a terminal, standard output to a file if wanted, and its exit status.

    Once the terminal shows `until`, somebody presses Ctrl-C.
    """
    command = [sys.executable, "-m", "envcraft", name, *map(str, arguments)]
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 140, 0, 0))
    with open(output or os.devnull, "wb") as file:
        process = subprocess.Popen(
            command,
            stdin=its,
            stdout=file if output else its,
            stderr=its,
            env={**os.environ, "TERM": "xterm-256color", **(environment or {})},
            start_new_session=True,
            # The terminal whose Ctrl-C reaches it.
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )
    os.close(its)
    shown, deadline = b"", time.monotonic() + 120
    while time.monotonic() < deadline:
        if select.select([ours], [], [], 0.2)[0]:
            try:
                shown += os.read(ours, 65536)
            except OSError:
                # Nobody has the other end any more.
                break
        if until and until.encode() in shown:
            os.write(ours, b"\x03")
            until = ""
    os.close(ours)
    return shown.decode().replace("\r\n", "\n"), process.wait(30)


def test_on_a_terminal_of_its_own_the_view_leaves_standard_output_alone(good: Path, tmp_path: Path) -> None:
    wanted = ("--sandbox", "process", "--checks", "api,determinism", "--format", "json")
    shown, status = on_terminal([good, *wanted], output=tmp_path / "out.json")
    assert status == 0
    assert json.loads((tmp_path / "out.json").read_bytes())["reports"][0]["verdict"] == "pass"
    assert "walk.py" in shown
    assert "✓ source" in shown
    assert re.search(r"\d steps", shown)
    assert shown.rindex(SHOW) > shown.rindex(HIDE)


def test_on_one_terminal_nothing_is_left_but_the_report(good: Path, bad: Path) -> None:
    shown, status = on_terminal([good, bad, *ARGUMENTS, "--workers", "1"])
    assert status == 1
    assert re.search(r"[01] of 2 judged", shown)
    assert shown.rindex(SHOW) > shown.rindex(HIDE)
    plain = subprocess.run(
        [sys.executable, "-m", "envcraft", "validate", good, bad, *ARGUMENTS, "--workers", "1"],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
        timeout=480,
    ).stdout
    assert words(screen(shown)) == words(plain)


def words(report: str) -> list[str]:
    """A report's words, wherever lines break, without the times."""
    return re.sub(r"\d+\.\d+ s", "", report).split()


def screen(shown: str) -> str:
    """What stands on a terminal that was sent this, line by line; it knows what the view uses."""
    lines, row, column = [""], 0, 0
    for part in re.findall(r"\x1b\[[?0-9;]*[a-zA-Z]|\r|\n|[^\x1b\r\n]+", shown):
        if part == "\r":
            column = 0
        elif part == "\n":
            row, column = row + 1, 0
            lines += [""] * (row == len(lines))
        elif part == "\x1b[1A":
            row -= 1
            assert row >= 0
        elif part == "\x1b[2K":
            lines[row] = ""
        elif part[0] == "\x1b":
            assert part in (HIDE, SHOW) or part.endswith("m")
        else:
            lines[row] = lines[row].ljust(column)[:column] + part + lines[row][column + len(part) :]
            column += len(part)
    return "\n".join(lines)


@pytest.mark.parametrize("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_terminals_that_want_less_get_less(good: Path, environment: dict[str, str]) -> None:
    shown, status = on_terminal([good, *ARGUMENTS], environment=environment)
    assert status == 0
    assert not COLOUR.search(shown)
    assert (HIDE in shown) is ("TERM" not in environment)


def test_ctrl_c_leaves_the_terminal_clean(good: Path) -> None:
    shown, status = on_terminal([good, "--sandbox", "process", "--budget", "thorough"], until=HIDE)
    assert status == 130
    assert shown.endswith("interrupted\n")
    assert shown.rindex(SHOW) > shown.rindex(HIDE)
    assert "Traceback" not in shown


@pytest.mark.parametrize(
    ("name", "note"),
    [
        ("validate", "none was judged; `envcraft audit FOLDER` stores each verdict and resumes"),
        ("audit", "none was judged; the same command resumes"),
    ],
)
def test_ctrl_c_leaves_what_was_judged_and_no_view(name: str, note: str, good: Path) -> None:
    good.with_name("other.py").write_text(good.read_text().replace("Walk", "Other"))
    thorough = ("--sandbox", "process", "--budget", "thorough", "--workers", "1")
    shown, status = on_terminal([good.parent, *thorough], until="of 2 judged", name=name)
    assert status == 130
    # The terminal echoes the key.
    lines = screen(shown).replace("^C", "").split("\n")
    assert [line.rstrip() for line in lines if line.strip()][-2:] == [note, "interrupted"]
    assert not re.search("of 2 judged|steps/s", "\n".join(lines))
