"""Reporters: formats that ``--format`` names. Each is a plugin that gives a subclass of :class:`Reporter`."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TextIO

from envcraft.events import Event

if TYPE_CHECKING:
    from envcraft.check import Rule

#: What a terminal could take for a command (control characters), or for another direction of writing.
_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


class Reporter(ABC):
    """Writes one run of ``envcraft validate`` to a text stream.

    Attributes:
        name: how ``--format`` names it.
        summary: one line for the help.
    """

    name: str
    summary: str = ""

    def __init__(self, output: TextIO, rules: Mapping[str, Rule]) -> None:
        """`rules` are the rules of all checks by code, for their names and fixes."""
        self.output = output
        self.rules = rules

    @abstractmethod
    def handle(self, event: Event) -> None:
        """Take in one event. :class:`~envcraft.events.Finished` is the last one, and carries the whole report."""


def one_line(text: Any) -> str:
    """Text that came from an environment, made safe to print: one line, without control characters."""
    return _UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", " ".join(str(text).split()))


def plural(number: int, noun: str) -> str:
    """A count in words: ``1 finding``, ``2,000 findings``."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"
