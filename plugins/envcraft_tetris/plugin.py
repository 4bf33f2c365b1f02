"""The built-in family `tetris` and the player of its games, as a plugin."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.demonstrations.player import Player
    from envcraft.families import Family


@hookimpl
def envcraft_families() -> list[Family]:
    from .family import TetrisFamily

    return [TetrisFamily()]


@hookimpl
def envcraft_players() -> list[Player]:
    from .player import TetrisPlayer

    return [TetrisPlayer()]
