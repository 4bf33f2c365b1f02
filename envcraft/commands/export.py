"""``envcraft export``: a corpus in a form that others can use."""

from __future__ import annotations

from pathlib import Path

import click

from .choices import exporter_named


@click.command()
@click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
@click.option("--to", "form", required=True, metavar="FORM", help="What to make, such as package.")
@click.option("--output", required=True, metavar="DIR", type=click.Path(path_type=Path), help="A new or empty folder.")
@click.option("--name", metavar="NAME", help="What the export is called, in place of after the corpus.")
@click.option("--all", "everything", is_flag=True, help="Export also what has no passing verdict.")
def export(corpus: Path, form: str, output: Path, name: str | None, everything: bool) -> None:
    """Write the environments of a corpus that have passed, with what was judged of them.

    CORPUS is a corpus, or a folder that was audited.
    """
    exporter = exporter_named(form)
    from envcraft.corpus.export import Order
    from envcraft.corpus.store import Store

    with Store(corpus) as store:
        for line in exporter.export(Order(store, output, name, everything)):
            click.echo(line)
