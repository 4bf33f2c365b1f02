"""Text for people: safe to print, with counts in words and short paths."""

from __future__ import annotations

import os
import re
from typing import Any

#: Control characters, changes of the writing direction, and what XML forbids.
_UNPRINTABLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)


def one_line(text: Any) -> str:
    """Make text of an environment safe to print: one line without control characters."""
    return printable(" ".join(str(text).split()))


def printable(text: Any) -> str:
    """Make text of an environment safe to print, keeping line feeds and tabs."""
    return _UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", str(text))


def plural(number: int, noun: str) -> str:
    """Write a count: ``1 finding``, ``2,000 findings``."""
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def with_article(noun: object) -> str:
    """A noun after its article: ``a uint8``, ``an int64``."""
    return f"{'an' if str(noun)[:1].lower() in 'aeio' else 'a'} {noun}"


def relative(path: str, folder: str | None = None) -> str:
    """Shorten a path to be relative to `folder` (the working directory) if it lies below it."""
    full = os.path.abspath(path)
    seen = os.path.relpath(full, folder)
    return full if seen.split(os.sep)[0] == os.pardir else seen
