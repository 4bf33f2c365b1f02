"""Ways to write environments that bring options of their own to ``envcraft generate``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click


@dataclass(frozen=True)
class Generator:
    """A command that ``envcraft generate`` becomes once one of its options is given.

    Attributes:
        command: its options are listed with those of ``envcraft generate``; where both have one of a name, such as
            ``--seed`` and ``--corpus``, the latter's is what its function gets.
        chosen_by: the parameters that choose it when they are given, such as ``concepts``.
        merge: for one that keeps files of its own in a corpus: takes over into the first folder what those in the
            second have, and gives what came over in words, such as ``3 answers``, or "". Raises OSError, EnvCraftError.
    """

    command: click.Command
    chosen_by: frozenset[str]
    merge: Callable[[Path, Path], str] | None = None

    @property
    def name(self) -> str:
        return str(self.command.name)
