"""The progress of a validation on stderr: a live view on a terminal, an occasional line elsewhere.

The view is drawn a few times a second by a thread of its own, from counts that the events keep up to date.
"""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import floor, log10
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

import click

from envcraft.cli.signals import uninterrupted
from envcraft.model.events import (
    CheckFinished,
    CheckStarted,
    Event,
    Finished,
    StepsTaken,
    SubjectFinished,
    SubjectStarted,
)
from envcraft.model.verdict import Outcome
from envcraft.reports.console import SIGNS, STYLES
from envcraft.reports.summary import OUTCOMES
from envcraft.text import one_line, plural

if TYPE_CHECKING:
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

_REFRESHES = 5
_LINE_EVERY = 15.0
#: Seconds before a speed is shown, and subjects before the remaining time is shown.
_SPEED_AFTER, _ENOUGH = 1.0, 3
#: Free columns at the right, so that the terminal's ^C does not wrap the line.
_FREE = 3
_SHORTEST_PATH = 16
_PLAIN_SIGNS = {**SIGNS, Outcome.PASS: "+", Outcome.FAIL: "x"}
_DIM = "bright_black"
_JUDGED = "judged"


@dataclass
class Row:
    """A subject in progress, `since` a reading of the clock; `running` is its current check."""

    path: str
    since: float
    steps: int = 0
    settled: dict[str, Outcome] = field(default_factory=dict)
    running: str = ""


class Tally:
    """Counts of events. `clock` returns seconds, and `verb` says what happens to an environment."""

    def __init__(self, clock: Callable[[], float] = time.monotonic, verb: str = _JUDGED) -> None:
        self.verb = verb
        self.rows: dict[str, Row] = {}
        self.total = 0
        self.outcomes: Counter[Outcome] = Counter()
        self._steps = 0
        self._clock = clock
        self._since: float | None = None

    def take(self, event: Event) -> None:
        """Count an event."""
        if isinstance(event, SubjectStarted):
            now = self._clock()
            self._since = now if self._since is None else self._since
            self.total = event.total
            self.rows[event.path] = Row(one_line(event.path), now)
        elif isinstance(event, SubjectFinished):
            self.rows.pop(event.report.path, None)
            self.outcomes[event.report.outcome] += 1
            self._steps += event.report.steps
        elif not isinstance(event, Finished) and (row := self.rows.get(event.path)) is not None:
            if isinstance(event, CheckStarted):
                row.running = one_line(event.check)
            elif isinstance(event, StepsTaken):
                row.steps = event.steps
            elif isinstance(event, CheckFinished):
                row.settled[one_line(event.report.check)] = event.report.outcome
                row.running = ""

    @property
    def done(self) -> int:
        return self.outcomes.total()

    def seconds(self, row: Row) -> float:
        """Return the seconds since a subject started."""
        return self._clock() - row.since

    def speed(self, row: Row | None = None) -> float | None:
        """Return the steps per second of one subject or of all, or None if it is too early."""
        since = row.since if row else self._since
        steps = row.steps if row else self._steps + sum(other.steps for other in self.rows.values())
        elapsed = 0.0 if since is None else self._clock() - since
        return steps / elapsed if steps and elapsed >= _SPEED_AFTER else None

    def left(self) -> float | None:
        """Estimate the remaining seconds, or give None if it is too early."""
        under_way = len(self.rows)
        if self._since is None or self.done < max(_ENOUGH, under_way) or self.done >= self.total:
            return None
        # Subjects in progress are half done on average.
        done = self.done + under_way / 2
        return (self._clock() - self._since) / done * max(self.total - done, 0.0)

    def words(self) -> Iterator[tuple[str, str]]:
        """Return all counts as phrases with a style."""
        yield f"{self.done:,} of {self.total:,} {self.verb}", "bold"
        for outcome, words in OUTCOMES.items():
            # Where nothing is judged, nothing passes.
            if self.outcomes[outcome] and (self.verb == _JUDGED or outcome is not Outcome.PASS):
                yield f"{self.outcomes[outcome]:,} {words}", STYLES[outcome]
        if (speed := self.speed()) is not None:
            yield speed_words(speed), _DIM
        if (left := self.left()) is not None:
            yield left_words(left), _DIM


class Progress:
    """Show the events of one validation. Leaving the context clears the view and shows the cursor.

    Args:
        output: the reporter's stream, by default standard output. If it is a terminal, the view is hidden while the
            reporter writes.
        console: the terminal of the view, by default stderr if it is one.
        clock: returns seconds.
        verb: what happens to an environment, such as ``played``.
    """

    def __init__(
        self,
        output: TextIO | None = None,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
        verb: str = _JUDGED,
    ) -> None:
        self._tally = Tally(clock, verb)
        self._clock = clock
        self._console = console or _terminal()
        self._gives_way = (output or sys.stdout).isatty()
        self._live: Live | None = None
        self._lock = threading.Lock()
        self._drawn = self._said = clock()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._clear()

    def handle(self, event: Event) -> None:
        """Handle an event before the reporter does."""
        with self._lock:
            self._tally.take(event)
        if isinstance(event, Finished):
            self._clear()
        elif self._console is None:
            self._say()
        elif isinstance(event, SubjectFinished) and self._gives_way:
            self._clear()
        elif self._live is None:
            self._show(self._console)

    def _say(self) -> None:
        """Print a line if the last one is old enough."""
        now = self._clock()
        if now - self._said >= _LINE_EVERY:
            self._said = now
            click.echo(line(self._tally), err=True)

    def _show(self, console: Console) -> None:
        from rich.live import Live

        self._live = Live(
            console=console,
            get_renderable=self._draw,
            refresh_per_second=_REFRESHES,
            transient=True,
            redirect_stdout=False,
            vertical_overflow="crop",
        )
        # Redraw at once only after a long pause, to avoid flicker.
        refresh = self._clock() - self._drawn >= 1 / _REFRESHES
        # An interrupt inside rich would leave the view in an undefined state.
        with uninterrupted():
            self._live.start(refresh)

    def _clear(self) -> None:
        if self._live is not None:
            with uninterrupted():
                self._live.stop()
                self._live = None

    def _draw(self) -> Text:
        assert self._console is not None
        self._drawn = self._clock()
        signs = SIGNS if self._console.encoding.lower().startswith("utf") else _PLAIN_SIGNS
        with self._lock:
            picture = view(self._tally, self._console.width - _FREE, self._console.height, signs)
        if signs is _PLAIN_SIGNS:
            # Replace character by character, so that styles keep their places.
            picture.plain = picture.plain.encode(self._console.encoding, "replace").decode(self._console.encoding)
        return picture


def view(tally: Tally, width: int, height: int, signs: dict[Outcome, str]) -> Text:
    """Draw the subjects in progress and the counts within `width` columns and `height` lines."""
    from rich.text import Text

    rows = list(tally.rows.values())
    if tally.total == 1:
        lines = _alone(tally, rows[0], width, signs) if rows else []
    else:
        shown = rows[: max(height - 3, 1)]
        lines = _table(tally, shown, width, signs)
        if len(rows) > len(shown):
            lines.append(Text(f"and {len(rows) - len(shown):,} more", _DIM))
        lines.append(Text(" · " if signs is SIGNS else " - ").join(Text(*words) for words in tally.words()))
    for one in lines:
        one.truncate(width)
    return Text("\n", no_wrap=True, overflow="crop").join(lines[: max(height - 1, 1)])


def _alone(tally: Tally, row: Row, width: int, signs: dict[Outcome, str]) -> list[Text]:
    """Draw one subject with its checks."""
    from rich.text import Text

    facts = [plural(row.steps, "step")] if row.steps else []
    speed = tally.speed(row)
    facts += [speed_words(speed)] if speed is not None else []
    facts += [f"{tally.seconds(row):.0f} s"]
    said = f"  {', '.join(facts)}"
    lines = [Text(shortened(row.path, max(width - len(said), _SHORTEST_PATH)), "bold").append(said, _DIM)]
    names = [Text(f"{signs[outcome]} {name}", STYLES[outcome]) for name, outcome in row.settled.items()]
    names += [Text(f"{_running(signs)} {row.running}", "bold")] if row.running else []
    for name in names:
        if len(lines) > 1 and lines[-1].cell_len + 2 + name.cell_len <= width:
            lines[-1].append("  ").append_text(name)
        else:
            lines.append(Text("  ").append_text(name))
    return lines


def _table(tally: Tally, rows: list[Row], width: int, signs: dict[Outcome, str]) -> list[Text]:
    """Draw a line for each subject; a narrow terminal drops columns on the right."""
    from rich.text import Text

    cells = []
    for row in rows:
        strip = Text()
        for outcome in row.settled.values():
            strip.append(signs[outcome], STYLES[outcome])
        strip.append(_running(signs) if row.running else "", "bold")
        speed = tally.speed(row)
        steps = plural(row.steps, "step") if row.steps else ""
        cells.append(
            [strip, Text(row.running), Text(steps, _DIM), Text(speed_words(speed) if speed is not None else "", _DIM)]
        )
    widths = [max(cell.cell_len for cell in column) for column in zip(*cells, strict=True)]
    while len(widths) > 1 and width - sum(widths) - 2 * len(widths) < _SHORTEST_PATH:
        widths.pop()
    room = max(width - sum(widths) - 2 * len(widths), 1)
    paths = [Text(shortened(row.path, room)) for row in rows]
    room = max((path.cell_len for path in paths), default=0)
    lines = []
    for path, given in zip(paths, cells, strict=True):
        line = path.append(" " * (room - path.cell_len))
        for number, (cell, size) in enumerate(zip(given, widths, strict=False)):
            gap = " " * (size - cell.cell_len)
            # Align numbers to the right.
            line.append("  ").append_text(Text(gap) + cell if number > 1 else cell + Text(gap))
        lines.append(line)
    return lines


def line(tally: Tally) -> str:
    """Return the counts in one plain line, with the check of a single subject."""
    if tally.total != 1:
        return ", ".join(words for words, _ in tally.words())
    said = []
    for row in tally.rows.values():
        said += [f"{row.path}: {row.running or tally.verb}", plural(row.steps, "step")]
        said += [speed_words(speed)] if (speed := tally.speed(row)) is not None else []
    return ", ".join(said)


def speed_words(speed: float) -> str:
    """Format a speed with three digits: ``18,200 steps/s``."""
    return f"{round(speed, 2 - floor(log10(speed))):,.0f} steps/s" if speed >= 1 else "under 1 step/s"


def left_words(seconds: float) -> str:
    """Round an estimate to its precision: ``about 40 s left``, ``about 2 min left``, ``about 1.5 h left``."""
    if seconds < 90:
        return f"about {max(round(seconds / 5) * 5, 5)} s left"
    return f"about {seconds / 60:.0f} min left" if seconds < 90 * 60 else f"about {seconds / 3600:.1f} h left"


def shortened(text: str, width: int) -> str:
    """Shorten a path to `width` columns by omitting its middle."""
    from rich.cells import cell_len, set_cell_size

    if cell_len(text) <= width:
        return text
    head = set_cell_size(text, width // 3)
    tail = set_cell_size(text[::-1], max(width - width // 3 - 1, 0))[::-1]
    return f"{head}…{tail}"


def _running(signs: dict[Outcome, str]) -> str:
    return "…" if signs is SIGNS else "."


def _terminal() -> Console | None:
    """Return the terminal of stderr, or None if it cannot move the cursor."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(file=sys.stderr, highlight=False, markup=False, emoji=False)
    return console if console.is_interactive else None
