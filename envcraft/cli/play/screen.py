"""The interface of the screens on which a person plays: a terminal or a window."""

from __future__ import annotations

import contextlib
from abc import abstractmethod
from collections.abc import Sequence

from envcraft.cli.play.picture import Picture


class Screen(contextlib.AbstractContextManager["Screen"]):
    """Shows pictures and reads keys. Leaving the context restores the terminal or closes the window."""

    @abstractmethod
    def show(self, picture: Picture | None, lines: Sequence[str]) -> None:
        """Show a picture, if there is one, and lines of text below it."""

    @abstractmethod
    def pressed(self, seconds: float) -> list[str]:
        """Wait up to `seconds` for keys and return the names of the pressed keys in order."""

    @abstractmethod
    def held(self) -> list[str]:
        """Return the names of the keys that are or were down since the last call, the last pressed at the end."""
