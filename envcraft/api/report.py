"""A report that prints itself: as text, by Rich, and in notebooks."""

from __future__ import annotations

import html
import io
from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING, Literal

from envcraft.judging.selection import all_checks, rules_of
from envcraft.model.events import Finished, SubjectFinished
from envcraft.model.verdict import Outcome, Report
from envcraft.reports.console import ConsoleReporter
from envcraft.reports.html import HtmlReporter
from envcraft.reports.reporter import Reporter
from envcraft.reports.summary import counted

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions
    from rich.text import Text

_WORST_LAST = (Outcome.SKIP, Outcome.PASS, Outcome.UNDECIDED, Outcome.ERROR, Outcome.FAIL)
#: The height of a report in a notebook, in CSS pixels.
_HEIGHT = 480


class ShownReport(Report):
    """The report of ``envcraft.validate``. ``print`` and Rich show it as the console format, a notebook as HTML."""

    @classmethod
    def of(cls, report: Report) -> ShownReport:
        """Copy a report."""
        return cls(**{name: getattr(report, name) for name in report.__struct_fields__})

    @property
    def outcome(self) -> Outcome:
        """The worst outcome of the environments."""
        return max((subject.outcome for subject in self.reports), key=_WORST_LAST.index, default=Outcome.SKIP)

    def __repr__(self) -> str:
        outcomes = Counter(subject.outcome for subject in self.reports)
        return f"<Report: {', '.join(words for _, words in counted(outcomes)) or 'nothing judged'}>"

    def __str__(self) -> str:
        from rich.console import Console

        stream = io.StringIO()
        # Lines break where the reader's terminal breaks them.
        console = Console(
            file=stream,
            width=10_000,
            force_jupyter=False,
            highlight=False,
            markup=False,
            emoji=False,
            color_system=None,
        )
        return self._written(ConsoleReporter(stream, rules_of(all_checks()), console), stream).rstrip("\n")

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        from rich.console import Console
        from rich.text import Text

        stream = io.StringIO()
        # The outer console reduces the colours to those that its terminal has.
        system: Literal["truecolor"] | None = "truecolor" if console.color_system else None
        inner = Console(
            file=stream,
            width=options.max_width,
            force_terminal=console.is_terminal,
            force_jupyter=False,
            color_system=system,
            highlight=False,
            markup=False,
            emoji=False,
        )
        yield Text.from_ansi(self._written(ConsoleReporter(stream, rules_of(all_checks()), inner), stream))

    def _repr_html_(self) -> str:
        stream = io.StringIO()
        page = self._written(HtmlReporter(stream, rules_of(all_checks())), stream)
        # A frame keeps the page's styles and scripts apart from the notebook's.
        return f'<iframe srcdoc="{html.escape(page)}" width="100%" height="{_HEIGHT}" title="EnvCraft"></iframe>'

    def _written(self, reporter: Reporter, stream: io.StringIO) -> str:
        if isinstance(reporter, ConsoleReporter):
            # No command made this report, so there is none to add an option to.
            reporter.again = ""
        for subject in self.reports:
            reporter.handle(SubjectFinished(subject))
        reporter.handle(Finished(self))
        return stream.getvalue()
