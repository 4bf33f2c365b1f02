"""Build a source file from a skeleton with named slots and the fragments that the axes put into them."""

from __future__ import annotations

import re
import textwrap
from collections import defaultdict

_BLOCK = re.compile(r"^( *)<<(\w+)>>\n", re.MULTILINE)
_INLINE = re.compile(r"<<(\w+)>>")
_WIDTH = 119


class SourceBuilder:
    """Collects text fragments by slot. An empty slot leaves nothing in the result."""

    def __init__(self) -> None:
        self._slots: defaultdict[str, list[str]] = defaultdict(list)

    def add(self, slot: str, *texts: str) -> None:
        """Append fragments to a slot.

        Args:
            slot: The name of the slot.
            texts: Single lines, or blocks that start with a line break and are dedented. They may contain slots.
        """
        self._slots[slot] += [textwrap.dedent(text).strip("\n") if text.startswith("\n") else text for text in texts]

    def take(self, slot: str) -> list[str]:
        """Remove the fragments of a slot and return them."""
        return self._slots.pop(slot, [])

    def render(self, skeleton: str) -> str:
        """Fill every slot of a skeleton.

        A slot alone on its line takes its fragments as lines at that indent. The slots `functions` and `methods`
        separate them by the blank lines of PEP 8. A slot within a line takes its fragments joined by commas.
        """
        text = skeleton
        while _BLOCK.search(text):
            text = _BLOCK.sub(self._block, text)
        text = _INLINE.sub(lambda match: ", ".join(self._slots[match[1]]), text)
        return re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE)

    def _block(self, match: re.Match[str]) -> str:
        indent, slot = match.groups()
        separator = {"functions": "\n\n\n", "methods": "\n\n"}.get(slot, "\n")
        text = separator.join(self._slots[slot])
        return textwrap.indent(text, indent) + "\n" if text else ""


def paragraph(*sentences: str) -> str:
    """Join sentences into the wrapped lines of a docstring paragraph."""
    return textwrap.fill(" ".join(sentences), _WIDTH, break_on_hyphens=False)
