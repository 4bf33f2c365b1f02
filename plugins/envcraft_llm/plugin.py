"""The commands that generate."""

from __future__ import annotations

import click

from envcraft.plugins import hookimpl


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from .concepts.command import concepts

    return [concepts]
