"""The prompts: Markdown files in ``prompts``, one a stage, with parts under level-1 headings and names to be filled in.

``{{brief}}`` is filled in with a text, ``{{> contract}}`` with another file of the folder. The digest of a prompt is
that of all that it is made of, so that what was asked with another wording can be told apart.
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
_INCLUDED = re.compile(r"^\{\{> ([\w-]+)\}\}$", re.MULTILINE)
_NAME = re.compile(r"\{\{(\w+)\}\}")


@dataclass(frozen=True)
class Prompt:
    """A prompt. `parts` are its texts by their headings, `sha256` is of the file with all that it includes."""

    parts: Mapping[str, str]
    sha256: str

    def fill(self, part: str, **values: object) -> str:
        """One part with its names filled in, each once: what is filled in is not looked at again. Raises KeyError."""
        return _NAME.sub(lambda found: str(values[found[1]]), self.parts[part])


@cache
def prompt(stage: str) -> Prompt:
    """The prompt of a stage."""
    text = _INCLUDED.sub(lambda found: _read(found[1]), _read(stage))
    pieces = _PART.split(text)
    # What stands before the first heading is for those who read the file.
    parts = {name: body.strip() for name, body in zip(pieces[1::2], pieces[2::2], strict=True)}
    return Prompt(parts, hashlib.sha256(text.encode()).hexdigest())


def _read(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text("utf-8").strip()
