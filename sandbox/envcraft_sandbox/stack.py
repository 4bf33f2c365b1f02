"""The Python stack that a job's process writes to its output when its host asks for it, or when it crashes.

It is output of untrusted code like any other: only line numbers that exist in the target's file are taken from it.
"""

from __future__ import annotations

import re

from envcraft_protocol.jobs import Target

_BEGIN = b"Stack (most recent call first):\n"
_FRAME = b"  "


class Stack:
    """Reads the lines of a target's file from a stack.

    Args:
        target: the target. The lines of one that is installed are unknown.

    Attributes:
        lines: those that were running, the innermost call first.
    """

    def __init__(self, target: Target) -> None:
        self.lines: tuple[int, ...] = ()
        self._frame: re.Pattern[bytes] | None = None
        self._last = 0
        if target["kind"] == "source":
            project = target.get("project")
            name = project["path"] if project else target["filename"]
            shown = re.escape(name.encode("ascii", "backslashreplace"))
            self._frame = re.compile(rb'  File "%b", line (\d{1,7}) in ' % shown)
            self._last = len(target["source"].splitlines())

    @staticmethod
    def begins(output: bytes) -> bool:
        """Whether a stack begins in an output."""
        return _BEGIN in output

    def take(self, output: bytes) -> bytes:
        """Read the first stack of an output, and return what precedes it."""
        before, _, stack = output.partition(_BEGIN)
        if self._frame is not None:
            found = []
            for frame in stack.split(b"\n"):
                if not frame.startswith(_FRAME):
                    break
                if (match := self._frame.match(frame)) and 1 <= int(match[1]) <= self._last:
                    found.append(int(match[1]))
            self.lines = tuple(found)
        return before
