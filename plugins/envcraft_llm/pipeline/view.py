"""The cascade while it runs: on a terminal a table that is drawn anew, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, get_args

import click

from envcraft.cli import uninterrupted
from envcraft.progress import left_words
from envcraft.reports import one_line
from envcraft.stages import Result
from envcraft_llm.endpoint.accounts import Accounts

from .tables import Row

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live

    from .runner import Tally

_REFRESHES = 2
_LINE_EVERY = 15.0
#: Seconds before a speed means something.
_SPEED_AFTER = 5.0


class View:
    """Shows how far a run has come, on stderr. `rows` is the table of all stages at its start, `accounts` what is used.

    `console` is the terminal, by default stderr if it is one.
    """

    def __init__(
        self,
        rows: Sequence[Row],
        tally: Tally,
        accounts: Accounts | None = None,
        console: Console | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._rows, self._tally, self._accounts, self._clock = rows, tally, accounts, clock
        self._began = self._told = clock()
        self._console = console or _terminal()
        self._live: Live | None = None
        self._warned = False

    def __enter__(self) -> View:
        if self._console is not None:
            from rich.live import Live

            # Drawn by the thread of the loop, which changes what is drawn.
            self._live = Live(console=self._console, auto_refresh=False, transient=True, redirect_stdout=False)
            with uninterrupted():
                self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            with uninterrupted():
                self._live.stop()

    def tell(self) -> None:
        """To be called whenever something has changed; draws no more often than anybody can read. The first thing that
        could not be judged is told at once, since it may be so for all that follow.
        """
        if self._tally.unjudged and not self._warned:
            self._warned = True
            click.echo(one_line(self._tally.unjudged[0]), err=True)
        now = self._clock()
        if now - self._told < (_LINE_EVERY if self._live is None else 1 / _REFRESHES):
            return
        self._told = now
        if self._live is None:
            click.echo(self.line(), err=True)
        else:
            self._live.update(self.draw(), refresh=True)

    def rows(self) -> list[Row]:
        """The table as it is now."""
        now = self._tally.now
        found = []
        for row in self._rows:
            passed, rejected, failed = (now.get((row.stage, result), 0) for result in get_args(Result))
            found.append(
                row._replace(
                    entered=row.entered + passed + rejected + failed,
                    passed=row.passed + passed,
                    rejected=row.rejected + rejected,
                    failed=row.failed + failed,
                )
            )
        return found

    def line(self) -> str:
        """The state in one line."""
        return ", ".join(
            [f"{row.stage} {row.passed:,}/{row.entered:,}" for row in self.rows() if row.entered] + self.facts()
        )

    def facts(self) -> list[str]:
        """What is told below the table: how far it is, how fast, what it costs."""
        tally, seconds = self._tally, self._clock() - self._began
        found = [f"{tally.settled:,} of {tally.total:,} settled"]
        if self._accounts is not None and self._accounts.total.tokens:
            found.append(f"{self._accounts.tokens_per_second:,.0f} tokens/s")
            if self._accounts.total.cost:
                found.append(f"cost {self._accounts.total.cost:,.2f}")
        if seconds >= _SPEED_AFTER and self._rows:
            validated = tally.now.get((self._rows[-1].stage, "passed"), 0)
            found.append(f"{validated / seconds * 3600:,.0f} validated/h")
            if tally.fresh and tally.settled < tally.total:
                found.append(left_words(seconds / tally.fresh * (tally.total - tally.settled)))
        if tally.unjudged:
            found.append(f"{len(tally.unjudged):,} could not be judged")
        return found

    def draw(self) -> RenderableType:
        """The table, and a line below it."""
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        table = Table("stage", box=None, pad_edge=False)
        for name in ("in", "out", "rejected", "failed", "passed", "now in it"):
            table.add_column(name, justify="right")
        for row in self.rows():
            rate = f"{row.rate.estimate:.1%}" if row.entered else ""
            numbers = (row.entered, row.passed, row.rejected, row.failed)
            here = self._tally.under_way.get(row.stage, 0)
            table.add_row(row.stage, *(_shown(number) for number in numbers), rate, _shown(here))
        return Group(table, Text(" · ".join(self.facts()), style="bright_black"))


def _shown(number: int) -> str:
    return f"{number:,}" if number else ""


def _terminal() -> Console | None:
    """The terminal that stderr is, unless it cannot move the cursor."""
    if not sys.stderr.isatty():
        return None
    from rich.console import Console

    console = Console(file=sys.stderr, highlight=False, markup=False, emoji=False)
    return console if console.is_interactive else None
