"""The export format ``site``: the report on a corpus, as ``envcraft corpus report --no-previews`` writes it."""

from __future__ import annotations

from envcraft.corpus.export.exporter import Exporter, Order
from envcraft.errors import UsageError
from envcraft.plugins import hookimpl


class SiteExporter(Exporter):
    """Writes the report."""

    name = "site"
    summary = "the report on all environments, with the previews that exist, as a site of static files"

    def export(self, order: Order) -> list[str]:
        for option, value in (("--name", order.name), ("--licence", order.licence)):
            if value is not None:
                raise UsageError(f"a report does not use {option} {value}; leave it out")
        from envcraft.corpus.report.write import check_requirements, followed_folder, write_report

        check_requirements(order.output)
        write_report(order.store, order.output, followed_folder(order.store))
        return [f"{order.output / 'index.html'} opens in a browser; any static web server can publish {order.output}"]


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    """Offer the format."""
    return [SiteExporter()]
