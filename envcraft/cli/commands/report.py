"""``envcraft corpus report``."""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path

import click

from envcraft.cli import completion
from envcraft.cli.configured import PartlyConfigured
from envcraft.cli.options import MOST_WORKERS, runtime_option
from envcraft.corpus.store import open_store
from envcraft.judging.selection import driver_named


@click.command(cls=PartlyConfigured, short_help="Write a report on the last verdicts.")
@click.argument("corpus", metavar="CORPUS|FOLDER", type=click.Path(path_type=Path))
@click.option(
    "--output",
    metavar="DIR",
    required=True,
    type=click.Path(path_type=Path),
    help="The folder of the report. It is created, or replaced if it is a report.",
)
@click.option(
    "--previews/--no-previews",
    default=True,
    show_default=True,
    help="Play one short episode of each environment that has no preview yet.",
)
@click.option(
    "--sandbox",
    default="auto",
    show_default=True,
    metavar="NAME",
    shell_complete=completion.sandboxes,
    help="The sandbox for previews.",
)
@runtime_option
@click.option(
    "--workers",
    type=click.IntRange(1, MOST_WORKERS),
    show_default="as many as cores",
    help="The number of previews that are made at the same time.",
)
def report(corpus: Path, output: Path, previews: bool, sandbox: str, runtime: str | None, workers: int | None) -> None:
    """Write a report on the last verdicts.

    The report is a site of static files, with tables for other programs. This command judges nothing.
    """
    from envcraft.corpus.report.write import check_requirements, default_contract, followed_folder, write_report

    check_requirements(output)
    with contextlib.ExitStack() as stack:
        driver = None
        if previews:
            driver = driver_named(sandbox, runtime=runtime)
            stack.callback(driver.close)
        store = stack.enter_context(open_store(corpus, previews))
        contract = default_contract(store) if previews else None
        write_report(store, output, followed_folder(store), contract, driver, workers, partial(click.echo, err=True))
