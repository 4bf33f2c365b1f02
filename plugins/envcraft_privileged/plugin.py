"""The built-in players, the command that has them play, and what it recorded as a data set of Minari."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.corpus.export import Exporter
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
