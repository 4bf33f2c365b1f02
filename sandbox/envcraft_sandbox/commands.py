"""The commands ``envcraft doctor`` and ``envcraft sandbox build``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from envcraft.sandbox import Availability, Driver


@click.command()
@click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)
def doctor(form: str) -> None:
    """Tell which sandboxes work here, how far each isolates, and what to install."""
    from envcraft.plugins import plugins

    loaded = plugins()
    drivers = sorted(loaded.collect("envcraft_sandbox_drivers"), key=lambda driver: -driver.rank)
    found: list[tuple[Driver, Availability]] = []
    for driver in drivers:
        try:
            found.append((driver, driver.probe()))
        except Exception as error:
            loaded.note(f"sandbox {driver.name}", error)
    auto = next((driver.name for driver, available in found if available.works), None)
    broken = [{"plugin": each.plugin, "error": each.error} for each in loaded.broken]
    if form == "json":
        sandboxes = [_row(driver, available) for driver, available in found]
        click.echo(json.dumps({"sandboxes": sandboxes, "auto": auto, "broken": broken}, indent=2))
    else:
        _show(found, auto, broken)
    if auto is None:
        raise SystemExit(3)


@click.group()
def sandbox() -> None:
    """Manage the sandboxes."""


@sandbox.command()
@click.option(
    "--base",
    metavar="IMAGE",
    help="Image to build on, with Python 3.11 or later and pip; `host` stands for the running interpreter, "
    "and needs no registry.  [default: python:3.11-slim]",
)
def build(base: str | None) -> None:
    """Build the image of the docker sandbox."""
    from . import build as image

    tag, digest = image.build(base or image.DEFAULT_BASE, lambda words: click.echo(words, err=True))
    click.echo(f"{tag} {digest}")


def _row(driver: Driver, available: Availability) -> dict[str, Any]:
    return {
        "name": driver.name,
        "isolation": driver.isolation.value,
        "works": available.works,
        "layers": available.layers,
        "reason": available.reason,
        "fix": available.fix,
    }


def _show(found: list[tuple[Driver, Availability]], auto: str | None, broken: list[dict[str, str]]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    table = Table("sandbox", "isolation", "works", "layers in force, or what to do")
    for driver, available in found:
        words = ", ".join(available.layers) if available.works else f"{available.reason}: {available.fix}"
        works = "[green]yes[/]" if available.works else "[red]no[/]"
        table.add_row(escape(driver.name), driver.isolation.value, works, escape(words))
    console.print(table)
    if auto is None:
        console.print("No sandbox works here: nothing can be validated.")
    else:
        console.print(f"`--sandbox auto` takes {auto}.")
    for each in broken:
        console.print(f"[red]broken plugin[/] {escape(each['plugin'])}: {escape(each['error'])}")
