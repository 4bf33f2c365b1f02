"""``envcraft export``."""

from __future__ import annotations

from pathlib import Path

import click

from envcraft.cli import completion
from envcraft.corpus.export.exporter import exporter_named
from envcraft.registry import offered
from envcraft.text import plural


class _ExportCommand(click.Command):
    """Lists the formats of all plugins in the help."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Formats"):
            formatter.write_dl([(exporter.name, exporter.summary) for exporter in offered("envcraft_exporters")])


@click.command(cls=_ExportCommand, short_help="Export a corpus for use elsewhere.")
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "form",
    required=True,
    metavar="FORMAT",
    shell_complete=completion.exports,
    help="The format, from the list below.",
)
@click.option(
    "--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="The folder to write, new or empty."
)
@click.option("--name", metavar="NAME", help="The name of the export.  [default: that of the corpus]")
@click.option("--all", "everything", is_flag=True, help="Include environments that have not passed.")
@click.option(
    "--licence", metavar="NAME", help="The licence of the sources, such as mit, if the corpus does not state one."
)
def export(corpus: Path, form: str, output: Path, name: str | None, everything: bool, licence: str | None) -> None:
    """Export the environments that have passed, with their verdicts.

    CORPUS is a corpus or an audited folder.
    """
    exporter = exporter_named(form)
    from envcraft.corpus.export.exporter import Order
    from envcraft.corpus.store import open_store

    with open_store(corpus) as store:
        order = Order(store, output, name, everything, licence)
        for line in exporter.export(order):
            click.echo(line)
        if left_out := order.left_out:
            words = "needs other files of its project" if left_out == 1 else "need other files of their projects"
            click.echo(f"left out {plural(left_out, 'environment')} that {words}", err=True)
