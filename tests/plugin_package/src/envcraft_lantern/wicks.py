"""A further way for ``envcraft generate`` to write environments, with an option of its own."""

from __future__ import annotations

from pathlib import Path

import click

from .doors import DoorsFamily


@click.command()
@click.option("--wicks", type=click.IntRange(1), metavar="N", help="Games of doors, so many of them, lit by candles.")
@click.option("--seed", type=int, default=0)
@click.option("--output", type=click.Path(path_type=Path))
def wicks(wicks: int, seed: int, output: Path | None) -> None:
    """Doors, one file a candle."""
    folder = output or Path("wicks")
    folder.mkdir(parents=True, exist_ok=True)
    for made in DoorsFamily().generate(wicks, seed):
        (folder / f"{made.name}.py").write_text(made.source, "utf-8")
    click.echo(f"{wicks} written")
