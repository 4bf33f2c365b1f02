"""Registers the built-in players, the command ``demos`` and the exporter for Minari."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.corpus.export.exporter import Exporter
    from envcraft.demonstrations.player import Player


@hookimpl
def envcraft_commands() -> list[click.Command]:
    from .commands import demos

    return [demos]


@hookimpl
def envcraft_players() -> list[Player]:
    from .players import NoopPlayer, RandomPlayer, SearchPlayer

    return [RandomPlayer(), NoopPlayer(), SearchPlayer()]


@hookimpl
def envcraft_exporters() -> list[Exporter]:
    from .minari import MinariExporter

    return [MinariExporter()]
