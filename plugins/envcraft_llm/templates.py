"""Prompt templates: Markdown files in ``prompts``, one per stage.

A level-1 heading begins a part. ``{{brief}}`` is replaced by a value, ``{{> contract}}`` by another file of the folder.
The digest of a template covers the files that it includes, so that provenance identifies the exact text.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent / "prompts"
_PART = re.compile(r"^# (.+)$", re.MULTILINE)
_INCLUDE = re.compile(r"^\{\{> ([\w-]+)\}\}$", re.MULTILINE)
_NAME = re.compile(r"\{\{(\w+)\}\}")


@dataclass(frozen=True)
class Prompt:
    """A prompt template.

    Attributes:
        parts: Texts by heading.
        sha256: Digest of the file with its includes.
    """

    parts: Mapping[str, str]
    sha256: str

    def fill(self, part: str, **values: object) -> str:
        """Return one part with its names replaced. Values are not expanded again.

        Raises:
            KeyError: If the part does not exist, or a name has no value.
        """
        return _NAME.sub(lambda match: str(values[match[1]]), self.parts[part])


@cache
def prompt(stage: str) -> Prompt:
    """Return the template of a stage."""
    text = _INCLUDE.sub(lambda match: _read(match[1]), _read(stage))
    pieces = _PART.split(text)
    # The text before the first heading is for readers of the file.
    parts = {name: body.strip() for name, body in zip(pieces[1::2], pieces[2::2], strict=True)}
    return Prompt(parts, hashlib.sha256(text.encode()).hexdigest())


def _read(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text("utf-8").strip()
