"""``envcraft export``: a corpus in a form that others can use."""

from __future__ import annotations

from pathlib import Path

import click

from envcraft.cli import offered

from .choices import exporter_named


class _Forms(click.Command):
    """Its help lists the forms that the plugins give."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        super().format_options(ctx, formatter)
        with formatter.section("Forms"):
            formatter.write_dl([(exporter.name, exporter.summary) for exporter in offered("envcraft_exporters")])


@click.command(cls=_Forms)
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option("--to", "form", required=True, metavar="FORM", help="What to make: one of the forms below.")
@click.option("--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="A new or empty folder.")
@click.option("--name", metavar="NAME", help="What the export is called, in place of after the corpus.")
@click.option("--all", "everything", is_flag=True, help="Export also what has no passing verdict.")
@click.option(
    "--licence", metavar="NAME", help="What the sources are licensed under, such as mit, where the corpus does not say."
)
def export(corpus: Path, form: str, output: Path, name: str | None, everything: bool, licence: str | None) -> None:
    """Write the environments of a corpus that have passed, with what was judged of them.

    CORPUS is a corpus, or a folder that was audited.
    """
    exporter = exporter_named(form)
    from envcraft.corpus.export import Order
    from envcraft.corpus.store import opened

    with opened(corpus) as store:
        for line in exporter.export(Order(store, output, name, everything, licence)):
            click.echo(line)
