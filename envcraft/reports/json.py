"""The report as one JSON object, for programs and for ``envcraft replay``."""

from __future__ import annotations

from envcraft.model.events import Event, Finished
from envcraft.plugins import hookimpl
from envcraft.reports.reporter import Reporter


class JsonReporter(Reporter):
    """Write the whole report at the end, because half a JSON object is useless."""

    name = "json"
    summary = "one JSON object, which `envcraft replay` reads"
    suffix = ".json"

    def handle(self, event: Event) -> None:
        if isinstance(event, Finished):
            self.output.write(event.report.to_json().decode() + "\n")


@hookimpl
def envcraft_reporters() -> list[type[Reporter]]:
    return [JsonReporter]
