"""The plugin of the family `tetris` and its player."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.demonstrations.player import Player
    from envcraft.environments.families import Family


@hookimpl
def envcraft_families() -> list[Family]:
    from envcraft_tetris.family import TetrisFamily

    return [TetrisFamily()]


@hookimpl
def envcraft_players() -> list[Player]:
    from envcraft_tetris.player import TetrisPlayer

    return [TetrisPlayer()]
