"""The plugin of the family `composer` and its player."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.demonstrations.player import Player
    from envcraft.environments.families import Family


@hookimpl
def envcraft_families() -> list[Family]:
    from envcraft_composer.family import ComposerFamily

    return [ComposerFamily()]


@hookimpl
def envcraft_players() -> list[Player]:
    from envcraft_composer.player import ComposerPlayer

    return [ComposerPlayer()]
