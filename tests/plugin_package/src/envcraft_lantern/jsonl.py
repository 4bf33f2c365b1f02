"""The report as JSON Lines, for long runs: each environment is written as soon as it is judged."""

from __future__ import annotations

import msgspec

from envcraft.model.events import Event, SubjectFinished
from envcraft.model.verdict import plain
from envcraft.reports.reporter import Reporter


class JsonLinesReporter(Reporter):
    """A line is what ``--format json`` has under ``reports`` for one environment."""

    name = "jsonl"
    summary = "one JSON object a line for each environment, as soon as it is judged"
    suffix = ".jsonl"

    def handle(self, event: Event) -> None:
        if isinstance(event, SubjectFinished):
            self.write(msgspec.json.encode(plain(event.report)).decode() + "\n")
            self.output.flush()
