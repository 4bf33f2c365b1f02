"""The built-in family `tetris`, as a plugin."""

from __future__ import annotations

from typing import TYPE_CHECKING

from envcraft.plugins import hookimpl

if TYPE_CHECKING:
    from envcraft.families import Family


@hookimpl
def envcraft_families() -> list[Family]:
    from .family import TetrisFamily

    return [TetrisFamily()]
