"""A source put together from fragments: a skeleton with named slots, and what the axes of a variant put into them."""

from __future__ import annotations

import re
import textwrap
from collections import defaultdict

_BLOCK = re.compile(r"^( *)<<(\w+)>>\n", re.MULTILINE)
_INLINE = re.compile(r"<<(\w+)>>")
_WIDTH = 119


class Draft:
    """Text for each slot of a skeleton; a slot that nothing was put into leaves nothing behind."""

    def __init__(self) -> None:
        self._slots: defaultdict[str, list[str]] = defaultdict(list)

    def add(self, slot: str, *texts: str) -> None:
        """Put texts behind those that the slot has: single lines, or blocks that begin with a line break and may be
        indented as a whole. They may have slots of their own.
        """
        self._slots[slot] += [textwrap.dedent(text).strip("\n") if text.startswith("\n") else text for text in texts]

    def take(self, slot: str) -> list[str]:
        """What was put into a slot, to be put elsewhere."""
        return self._slots.pop(slot, [])

    def write(self, skeleton: str) -> str:
        """The skeleton with every slot filled.

        A slot alone on its line takes all its fragments, one below the other at that indent; a slot `functions` or
        `methods` with the blank lines that Python style wants between them. A slot within a line takes its fragments
        joined by commas.
        """
        text = skeleton
        while _BLOCK.search(text):
            text = _BLOCK.sub(self._block, text)
        text = _INLINE.sub(lambda found: ", ".join(self._slots[found[1]]), text)
        return re.sub(r"[ \t]+$", "", text, flags=re.MULTILINE)

    def _block(self, found: re.Match[str]) -> str:
        indent, slot = found.groups()
        between = {"functions": "\n\n\n", "methods": "\n\n"}.get(slot, "\n")
        text = between.join(self._slots[slot])
        return textwrap.indent(text, indent) + "\n" if text else ""


def paragraph(*sentences: str) -> str:
    """Sentences as lines of a docstring."""
    return textwrap.fill(" ".join(sentences), _WIDTH, break_on_hyphens=False)
