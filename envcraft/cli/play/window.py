"""Play in a window, by pygame."""

from __future__ import annotations

import importlib.util
import os
import sys
import time
from collections.abc import Sequence
from types import TracebackType
from typing import Any

from envcraft.cli.play.picture import Picture, fit
from envcraft.cli.play.screen import Screen
from envcraft.errors import UsageError

_SIZE = (588, 588)
_LINE = 18
_BACK, _INK = (24, 24, 28), (220, 220, 220)
_NAMES = {"return": "enter", "enter": "enter"}


def available() -> bool:
    """Whether there is a display, and pygame is installed."""
    return has_display() and importlib.util.find_spec("pygame") is not None


def has_display() -> bool:
    """Whether a window can have a display: macOS always has one, other systems name it in a variable."""
    named = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return named or sys.platform == "darwin"


class Window(Screen):
    """A window of fixed size. Raises UsageError without pygame or a display."""

    def __init__(self, title: str) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ImportError:
            raise UsageError("--window needs pygame; install it with `pip install 'envcraft-rl[play]'`") from None
        self._pygame: Any = pygame
        self._title = title
        self._down: list[str] = []
        self._new: list[str] = []
        self._surface: Any = None

    def __enter__(self) -> Window:
        pygame = self._pygame
        try:
            pygame.display.init()
            pygame.font.init()
            self._surface = pygame.display.set_mode(_SIZE)
        except pygame.error as error:
            self.__exit__(None, None, None)
            raise UsageError(f"no window can be opened here ({error}); play in the --terminal") from None
        pygame.display.set_caption(self._title)
        self._font = pygame.font.Font(None, _LINE + 2)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._pygame.quit()

    def show(self, picture: Picture | None, lines: Sequence[str]) -> None:
        pygame, surface = self._pygame, self._surface
        room = _SIZE[1] - _LINE * len(lines) - 4
        surface.fill(_BACK)
        if picture is not None and room > 0:
            shown = fit(picture, _SIZE[0], room)
            surface.blit(pygame.surfarray.make_surface(shown.swapaxes(0, 1)), ((_SIZE[0] - shown.shape[1]) // 2, 0))
        for number, line in enumerate(lines):
            surface.blit(self._font.render(line, True, _INK), (6, max(room, 0) + 4 + number * _LINE))
        pygame.display.flip()

    def pressed(self, seconds: float) -> list[str]:
        pygame = self._pygame
        deadline = time.monotonic() + seconds
        keys: list[str] = []
        while not keys:
            for event in pygame.event.get():
                if event.type == pygame.QUIT:
                    keys.append("escape")
                elif event.type in (pygame.KEYDOWN, pygame.KEYUP):
                    key = pygame.key.name(event.key, use_compat=True)
                    key = _NAMES.get(key, key)
                    if event.type == pygame.KEYDOWN:
                        keys.append(key)
                        self._down.append(key)
                    elif key in self._down:
                        self._down.remove(key)
            if (left := deadline - time.monotonic()) <= 0:
                break
            if not keys:
                time.sleep(min(left, 0.002))
        self._new += keys
        return keys

    def held(self) -> list[str]:
        held = [*self._down, *(key for key in self._new if key not in self._down)]
        self._new.clear()
        return held
