"""A rule's guide: why the defect is bad, a minimal example, how it is detected, and what the check misses.

The guide of a code is the file ``guides/CODE.md`` beside the module of its check. A rule without such a file has no
guide.
"""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import msgspec

from envcraft.judging.check import Check

_HEADINGS = ("Why is this bad?", "Example", "How it is detected", "What it misses")
_HEADING = re.compile(r"^## (.+)\n", re.MULTILINE)
_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_SETTING = re.compile(r"# (contract|budget): (\S+)\n")


class Example(msgspec.Struct, frozen=True):
    """A minimal environment that has the defect.

    Attributes:
        source: the file. Its first lines name the settings that differ from the defaults: ``# contract: gymnasium``.
        policy: the privileged policy that shows the defect; "" if none is needed.
    """

    source: str
    policy: str = ""

    @property
    def settings(self) -> dict[str, str]:
        """The options of ``envcraft validate`` that the source names."""
        found: dict[str, str] = {}
        at = 0
        while match := _SETTING.match(self.source, at):
            found[match[1]] = match[2]
            at = match.end()
        return found


class Guide(msgspec.Struct, frozen=True):
    """The sections of a guide, as Markdown."""

    harm: str
    example: str
    detected: str
    missed: str

    def code(self) -> Example:
        """The code of the example."""
        source, policy, *_ = [*_BLOCK.findall(self.example), ""]
        return Example(source, policy)


def guide_file(check: Check, code: str) -> Path:
    """The file of the guide of one of a check's codes, which need not exist."""
    return Path(inspect.getfile(type(check))).parent / "guides" / f"{code}.md"


def guide_of(check: Check, code: str) -> Guide | None:
    """Read the guide of one of a check's codes; None if it has none.

    Raises:
        ValueError: the file lacks a section, has an unknown one, or has an example without code.
    """
    path = guide_file(check, code)
    try:
        text = path.read_text("utf-8")
    except OSError:
        return None
    _, *parts = _HEADING.split(text)
    sections = dict(zip(parts[::2], map(str.strip, parts[1::2]), strict=True))
    if tuple(sections) != _HEADINGS:
        raise ValueError(f"{path.name} must have the sections {', '.join(_HEADINGS)}, in this order")
    if not _BLOCK.search(sections["Example"]):
        raise ValueError(f"{path.name}: the example has no block ```python")
    return Guide(*sections.values())
