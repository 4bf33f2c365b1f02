"""The index of words: which environments have a word in their source, concept or brief.

The page searches whole corpora without their sources: it loads the part of the index that has the first letters of a
word. Each part is a script like those of :mod:`envcraft.corpus.report.chunks`.
"""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path

import msgspec

#: Words as the page splits what is typed: letters, digits and underscores.
_WORD = re.compile(r"[a-z0-9_]{2,40}")
#: How many first letters of a word name its part.
_LETTERS = 2


class WordIndex:
    """Collects the words of environments, in the order of their numbers."""

    def __init__(self) -> None:
        self._places: defaultdict[str, array[int]] = defaultdict(lambda: array("I"))

    def add(self, number: int, texts: Iterable[str]) -> None:
        """Add the texts of an environment.

        Args:
            number: of the environment; greater than all before.
            texts: its source, and what else is searched.
        """
        for word in {word for text in texts for word in _WORD.findall(text.lower())}:
            self._places[word].append(number)

    def write(self, folder: Path) -> list[str]:
        """Write the parts, and return their names: the first letters of their words.

        Args:
            folder: an existing folder.

        Raises:
            OSError: a file cannot be written.
        """
        parts: defaultdict[str, dict[str, list[int]]] = defaultdict(dict)
        for word in sorted(self._places):
            places = self._places[word]
            # Differences are shorter than numbers.
            parts[word[:_LETTERS]][word] = [b - a for a, b in zip([0, *places], places, strict=False)]
        for name, words in parts.items():
            data = msgspec.json.encode(words)
            (folder / f"words-{name}.js").write_bytes(b'envcraft("words","%s",%s);\n' % (name.encode(), data))
        return list(parts)
