"""The progress line on stderr: what is being judged right now. Shown on a terminal only."""

from __future__ import annotations

import sys
from types import TracebackType

from rich.console import Console
from rich.status import Status
from rich.text import Text

from envcraft.events import CheckStarted, Event, Finished, SubjectFinished, SubjectStarted
from envcraft.reports import one_line


class Progress:
    """A spinner that gives way while a reporter prints."""

    def __init__(self) -> None:
        self._console = Console(file=sys.stderr, highlight=False, markup=False, emoji=False)
        self._status: Status | None = None
        self._done = 0
        self._total = 0

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._clear()

    def handle(self, event: Event) -> None:
        """Show an event; to be called before the reporter's turn."""
        if not self._console.is_terminal:
            return
        if isinstance(event, SubjectFinished | Finished):
            self._done += isinstance(event, SubjectFinished)
            self._clear()
        elif isinstance(event, SubjectStarted):
            self._total = event.total
        elif isinstance(event, CheckStarted):
            self._show(f"{self._done + 1} of {self._total}: {one_line(event.path)}, {event.check}")

    def _show(self, words: str) -> None:
        if self._status is None:
            self._status = Status(Text(words), console=self._console)
            self._status.start()
        else:
            self._status.update(Text(words))

    def _clear(self) -> None:
        if self._status is not None:
            self._status.stop()
            self._status = None
