"""Progress of a run on stderr: a live table on a terminal, a line from time to time elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, get_args

import click

from envcraft.cli.progress import left_words
from envcraft.cli.signals import uninterrupted
from envcraft.generation.stages import Result
from envcraft.text import one_line
from envcraft_llm.endpoint.usage import UsageTracker

from .tables import StageRow

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live

    from .runner import RunProgress

#: Refreshes of the table per second, and seconds between two lines.
_REFRESHES, _LINE_EVERY = 2, 15.0
#: Seconds after which a rate is meaningful.
_RATE_AFTER = 5.0


class ProgressDisplay:
    """Shows the progress of a run on stderr.

    Args:
        rows: Table of all stages at the start of the run.
        progress: Progress of the run, which the runner updates.
        usage: Usage of the model, or None.
        console: Terminal to draw on; by default stderr, if it is a terminal.
        clock: Returns the time in seconds.
    """

    def __init__(
        self,
        rows: Sequence[StageRow],
        progress: RunProgress,
        usage: UsageTracker | None = None,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._rows, self._progress, self._usage, self._clock = rows, progress, usage, clock
        self._start = self._updated = clock()
        self._console = console or _terminal()
        self._live: Live | None = None
        self._warned = False

    def __enter__(self) -> ProgressDisplay:
        if self._console is not None:
            from rich.live import Live

            # The event loop's thread draws, since it changes what is drawn.
            self._live = Live(console=self._console, auto_refresh=False, transient=True, redirect_stdout=False)
            with uninterrupted():
                self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            with uninterrupted():
                self._live.stop()

    def update(self) -> None:
        """Redraw, unless the last update is recent. The first judging error is printed at once."""
        if self._progress.errors and not self._warned:
            self._warned = True
            click.echo(one_line(self._progress.errors[0]), err=True)
        now = self._clock()
        if now - self._updated < (_LINE_EVERY if self._live is None else 1 / _REFRESHES):
            return
        self._updated = now
        if self._live is None:
            click.echo(self.line(), err=True)
        else:
            self._live.update(self.draw(), refresh=True)

    def rows(self) -> list[StageRow]:
        """Return the table with the outcomes of this run added."""
        outcomes = self._progress.outcomes
        current = []
        for row in self._rows:
            passed, rejected, failed = (outcomes.get((row.stage, result), 0) for result in get_args(Result))
            current.append(
                row._replace(
                    entered=row.entered + passed + rejected + failed,
                    passed=row.passed + passed,
                    rejected=row.rejected + rejected,
                    failed=row.failed + failed,
                )
            )
        return current

    def line(self) -> str:
        """Return the progress in one line."""
        return ", ".join(
            [f"{row.stage} {row.passed:,}/{row.entered:,}" for row in self.rows() if row.entered] + self.facts()
        )

    def facts(self) -> list[str]:
        """Return the facts below the table: concepts settled, rates, cost, time left."""
        progress, seconds = self._progress, self._clock() - self._start
        facts = [f"{progress.settled:,} of {progress.total:,} settled"]
        if self._usage is not None and self._usage.total.tokens:
            facts.append(f"{self._usage.tokens_per_second:,.0f} tokens/s")
            if self._usage.total.cost:
                facts.append(f"cost {self._usage.total.cost:,.2f}")
        if seconds >= _RATE_AFTER and self._rows:
            validated = progress.outcomes.get((self._rows[-1].stage, "passed"), 0)
            facts.append(f"{validated / seconds * 3600:,.0f} validated/h")
            if progress.processed and progress.settled < progress.total:
                facts.append(left_words(seconds / progress.processed * (progress.total - progress.settled)))
        if progress.errors:
            facts.append(f"{len(progress.errors):,} could not be judged")
        return facts

    def draw(self) -> RenderableType:
        """Return the table and the facts below it."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table("stage", box=None, pad_edge=False)
        for name in ("in", "out", "rejected", "failed", "passed", "in progress"):
            table.add_column(name, justify="right")
        for row in self.rows():
            rate = f"{row.rate.estimate:.1%}" if row.entered else ""
            numbers = (row.entered, row.passed, row.rejected, row.failed)
            in_stage = self._progress.in_stage.get(row.stage, 0)
            table.add_row(row.stage, *(_nonzero(number) for number in numbers), rate, _nonzero(in_stage))
        return Group(table, Text(" · ".join(self.facts()), style="bright_black"))


def _nonzero(number: int) -> str:
    return f"{number:,}" if number else ""


def _terminal() -> Console | None:
    """Stderr, if it is a terminal that can move the cursor."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(file=sys.stderr, highlight=False, markup=False, emoji=False)
    return console if console.is_interactive else None
