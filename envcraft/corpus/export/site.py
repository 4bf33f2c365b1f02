"""The audit report of a corpus as a site of files, as ``envcraft corpus report --no-previews`` writes it."""

from __future__ import annotations

from envcraft.corpus.export import Exporter, Order
from envcraft.errors import UsageError
from envcraft.plugins import hookimpl


class SiteExporter(Exporter):
    name = "site"
    summary = "the audit report on all environments, with the pictures that there are, as a site of files"

    def export(self, order: Order) -> list[str]:
        for option, value in (("--name", order.name), ("--licence", order.licence)):
            if value is not None:
                raise UsageError(f"the report has no place for {option} {value}; leave it out")
        from envcraft.corpus.report.command import followed, ready, write

        ready(order.output)
        write(order.store, order.output, followed(order.store), None, None, None)
        return [f"{order.output / 'index.html'} opens in a browser; any server of files can publish {order.output}"]


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    return [SiteExporter()]
