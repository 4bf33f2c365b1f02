"""Play in the terminal, also over ssh, with 24-bit colours and the keys that the terminal sends."""

from __future__ import annotations

import os
import re
import select
import sys
import termios
import time
import tty
from collections.abc import Sequence
from types import TracebackType
from typing import Any

from envcraft.cli.play.picture import Picture, fit, half_blocks
from envcraft.cli.play.screen import Screen
from envcraft.errors import UsageError

_ENTER = "\x1b[?1049h\x1b[?25l\x1b[2J"
_LEAVE = "\x1b[0m\x1b[?25h\x1b[?1049l"
_ARROWS = {"A": "up", "B": "down", "C": "right", "D": "left"}
_SEQUENCE = re.compile(r"\x1b[\[O][0-9;]*(?P<final>[ -/]*[@-~])|(?P<key>.)", re.DOTALL)
_NAMES = {" ": "space", "\r": "enter", "\n": "enter", "\x1b": "escape"}
#: Seconds after which a key counts as released. A terminal reports no releases, and a held key repeats sooner.
_HOLD = 0.08
_ESCAPE_SECONDS = 0.03


class Terminal(Screen):
    """The terminal of standard input and output. Raises UsageError if there is none."""

    def __init__(self) -> None:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise UsageError("standard input and output must be a terminal; use one, or play in a --window")
        self._input, self._output = sys.stdin.fileno(), sys.stdout.fileno()
        self._before: list[Any] = []
        self._lines: list[str] = []
        self._size = os.terminal_size((0, 0))
        self._seen: dict[str, float] = {}
        self._new: set[str] = set()
        self._closed = False

    def __enter__(self) -> Terminal:
        self._before = termios.tcgetattr(self._input)
        tty.setcbreak(self._input)
        mode = termios.tcgetattr(self._input)
        # No Ctrl-Z, because a stopped program could not restore the terminal.
        mode[6][termios.VSUSP] = b"\0"
        termios.tcsetattr(self._input, termios.TCSANOW, mode)
        self._write(_ENTER)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        try:
            self._write(_LEAVE)
        finally:
            termios.tcsetattr(self._input, termios.TCSAFLUSH, self._before)

    def show(self, picture: Picture | None, lines: Sequence[str]) -> None:
        size = os.get_terminal_size(self._output)
        if size != self._size:
            self._size, self._lines = size, []
            self._write("\x1b[2J")
        texts = [line[: size.columns - 1] for line in lines][: max(size.lines - 1, 1)]
        shown = []
        if picture is not None and size.lines > len(texts):
            shown = half_blocks(fit(picture, size.columns, 2 * (size.lines - len(texts))))
        shown += texts
        changed = [
            f"\x1b[{number};1H{line}\x1b[K"
            for number, line in enumerate(shown, 1)
            if number > len(self._lines) or line != self._lines[number - 1]
        ]
        if len(shown) < len(self._lines):
            changed.append(f"\x1b[{len(shown) + 1};1H\x1b[J")
        self._lines = shown
        self._write("".join(changed))

    def pressed(self, seconds: float) -> list[str]:
        if self._closed or not select.select([self._input], [], [], seconds)[0]:
            return []
        data = self._read()
        if data == b"\x1b" and select.select([self._input], [], [], _ESCAPE_SECONDS)[0]:
            # The rest of an arrow key may come a moment later.
            data += self._read()
        if not data:
            # The terminal is gone, and so is its player.
            self._closed = True
            return ["escape"]
        keys = [name for found in _SEQUENCE.finditer(data.decode(errors="replace")) if (name := _name(found))]
        now = time.monotonic()
        for key in keys:
            self._seen.pop(key, None)
            self._seen[key] = now
        self._new.update(keys)
        return keys

    def held(self) -> list[str]:
        now = time.monotonic()
        self._seen = {key: when for key, when in self._seen.items() if key in self._new or now - when < _HOLD}
        self._new.clear()
        return list(self._seen)

    def _read(self) -> bytes:
        try:
            return os.read(self._input, 1024)
        except OSError:
            return b""

    def _write(self, text: str) -> None:
        data = text.encode("utf-8", "replace")
        while data:
            data = data[os.write(self._output, data) :]


def _name(found: re.Match[str]) -> str:
    if final := found["final"]:
        return _ARROWS.get(final, "")
    return _NAMES.get(found["key"], found["key"].lower())
