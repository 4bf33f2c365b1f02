"""The plugin of the small families and their players."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.demonstrations.player import Player
    from envcraft.environments.families import Family


@hookimpl
def envcraft_families() -> list[Family]:
    from envcraft_families.families import families

    return [*families()]


@hookimpl
def envcraft_players() -> list[Player]:
    from envcraft_families.players import players

    return [*players()]
