"""``envcraft checks``, ``contracts`` and ``plugins``: list what is installed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from envcraft.contracts.lookup import all_contracts
from envcraft.judging.selection import all_checks
from envcraft.plugins import plugins as loaded_plugins

if TYPE_CHECKING:
    from rich.table import Table

_FORMAT = click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)


@click.command()
@_FORMAT
def checks(form: str) -> None:
    """List the checks and their rules."""
    found = all_checks()
    if form == "json":
        _print_json([{"check": check.name, "opt_in": check.opt_in, "rules": list(check.rules)} for check in found])
        return
    table = _table("check", "code", "severity", "rule")
    for check in found:
        for number, rule in enumerate(check.rules):
            name = f"{check.name}{' (opt-in)' * check.opt_in}"
            table.add_row("" if number else name, rule.code, rule.status, rule.summary)
    _print(table)


@click.command()
@_FORMAT
def contracts(form: str) -> None:
    """List the contracts."""
    found = all_contracts()
    if form == "json":
        _print_json(found)
        return
    table = _table("contract", "promises")
    for contract in found:
        table.add_row(contract.name, contract.summary)
    _print(table)


@click.command()
@_FORMAT
def plugins(form: str) -> None:
    """List the plugins, their hooks, and the broken plugins."""
    loaded = loaded_plugins()
    hooks = sorted({hook for plugin in loaded.list() for hook in plugin.hooks})
    for hook in hooks:
        # Only a call shows whether the plugin works.
        loaded.collect(hook)
    broken = {broken.plugin: broken.error for broken in loaded.broken}
    if form == "json":
        _print_json(
            {
                "plugins": [
                    {"plugin": plugin.name, "distribution": plugin.distribution, "hooks": plugin.hooks}
                    for plugin in loaded.list()
                ],
                "broken": [{"plugin": name, "error": error} for name, error in broken.items()],
            }
        )
        return
    table = _table("plugin", "distribution", "hooks")
    for plugin in loaded.list():
        words = ", ".join(hook.removeprefix("envcraft_") for hook in plugin.hooks)
        table.add_row(plugin.name, plugin.distribution, words)
    for name, error in broken.items():
        table.add_row(name, "", f"broken: {' '.join(error.split())}", style="red")
    _print(table)


def _table(*columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for number, column in enumerate(columns):
        table.add_column(column, no_wrap=number == 0)
    return table


def _print(table: Table) -> None:
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        # A file has no width to fit into: one line for each row.
        console.width = 240
    with console.capture() as capture:
        console.print(table)
    click.echo("\n".join(line.rstrip() for line in capture.get().strip("\n").splitlines()))


def _print_json(value: Any) -> None:
    import msgspec

    from envcraft.model.verdict import plain

    click.echo(msgspec.json.format(msgspec.json.encode(plain(value)), indent=2))
