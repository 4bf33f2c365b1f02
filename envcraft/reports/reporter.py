"""The base class of reporters, which consume the events of a run and write one format."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, TextIO

from envcraft.model.events import Event
from envcraft.model.frame import FrameSource
from envcraft.registry import lookup, named, offered

if TYPE_CHECKING:
    from envcraft.judging.check import Rule


class Reporter(ABC):
    """Writes one run of ``envcraft validate`` to a text stream.

    Attributes:
        name: the value for ``--format``.
        summary: one line for the help.
        suffix: the end of file names that selects this format without ``--format``, such as ``.json``.
        verbosity: -1 for less than usual (``--quiet``), 1 for everything (``--verbose``). The caller may set it.
        wants_frames: whether the reporter can show frames of findings. The caller may then set `frames`, which runs
            the environment again in the sandbox; the reporter may call it until it has handled
            :class:`~envcraft.model.events.Finished`.
    """

    name: str
    summary: str = ""
    suffix: str = ""
    verbosity: int = 0
    wants_frames: bool = False
    frames: FrameSource | None = None

    def __init__(self, output: TextIO, rules: Mapping[str, Rule]) -> None:
        """Write to `output`; `rules` are the rules of all checks by code."""
        self.output = output
        self.rules = rules

    @abstractmethod
    def handle(self, event: Event) -> None:
        """Handle one event. The last one, :class:`~envcraft.model.events.Finished`, holds the whole report."""

    def write(self, text: str) -> None:
        """Write text, escaping characters that the stream's encoding lacks."""
        encoding = self.output.encoding or "utf-8"
        self.output.write(text.encode(encoding, "backslashreplace").decode(encoding))


def reporter_for(path: str) -> type[Reporter] | None:
    """Return the reporter that the name of a file suggests, if there is one."""
    _, suffix = os.path.splitext(path)
    reporters: list[type[Reporter]] = offered("envcraft_reporters") if suffix else []
    return next((reporter for reporter in reporters if reporter.suffix == suffix.lower()), None)


def reporter_named(name: str) -> type[Reporter]:
    """Return the reporter of a name. Raises UsageError, which suggests the nearest name."""
    found: type[Reporter] = named("envcraft_reporters", name) or lookup(
        "format", name, {reporter.name: reporter for reporter in offered("envcraft_reporters")}
    )
    return found
