"""``envcraft checks``, ``contracts`` and ``plugins``: list what is installed."""

from __future__ import annotations

from typing import Any

import click

from envcraft.contracts.lookup import all_contracts
from envcraft.judging.selection import all_checks
from envcraft.plugins import plugins as loaded_plugins

#: The space between two columns, and the least width of the last one.
_GAP, _TEXT = 3, 20

_FORMAT = click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)


@click.command()
@_FORMAT
def checks(form: str) -> None:
    """List the checks and their rules."""
    found = all_checks()
    if form == "json":
        _print_json([{"check": check.name, "opt_in": check.opt_in, "rules": list(check.rules)} for check in found])
        return
    rows = [
        ["" if number else f"{check.name}{' (opt-in)' * check.opt_in}", rule.code, rule.status, rule.summary]
        for check in found
        for number, rule in enumerate(check.rules)
    ]
    _print(["check", "code", "severity", "rule"], rows)


@click.command()
@_FORMAT
def contracts(form: str) -> None:
    """List the contracts."""
    found = all_contracts()
    if form == "json":
        _print_json(found)
        return
    _print(["contract", "promises"], [[contract.name, contract.summary] for contract in found])


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
    rows = [
        [plugin.name, plugin.distribution, ", ".join(hook.removeprefix("envcraft_") for hook in plugin.hooks)]
        for plugin in loaded.list()
    ]
    rows += [[name, "", f"broken: {' '.join(error.split())}"] for name, error in broken.items()]
    _print(["plugin", "distribution", "hooks"], rows, red=len(broken))


def _print(columns: list[str], rows: list[list[str]], red: int = 0) -> None:
    """Print a table, whose last column wraps; its last `red` rows are red.

    If the other columns leave no room for the last one on a terminal, each row is a paragraph, so that no name is cut.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False, markup=False)
    names = sum(max(len(row[place]) for row in [columns, *rows]) + _GAP for place in range(len(columns) - 1))
    if console.is_terminal and console.width - names < _TEXT:
        for row in rows:
            click.echo(" ".join(filter(None, row)))
        return
    if not console.is_terminal:
        # A file has no width to fit into: one line for each row.
        console.width = 240
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for place, column in enumerate(columns, 1):
        table.add_column(column, no_wrap=place < len(columns))
    for number, row in enumerate(rows):
        table.add_row(*row, style="red" if number >= len(rows) - red else None)
    with console.capture() as capture:
        console.print(table)
    click.echo("\n".join(line.rstrip() for line in capture.get().strip("\n").splitlines()))


def _print_json(value: Any) -> None:
    import msgspec

    from envcraft.model.verdict import plain

    click.echo(msgspec.json.format(msgspec.json.encode(plain(value)), indent=2))
