"""Registers the command ``explore``."""

from __future__ import annotations

import click

from envcraft.plugins import hookimpl


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from .commands import explore

    return [explore]
