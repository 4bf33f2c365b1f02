"""Generators: commands of plugins that ``envcraft generate`` runs if one of their options is given."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click


@dataclass(frozen=True)
class Generator:
    """A command that ``envcraft generate`` runs if one of its options is given.

    Attributes:
        command: The command. Its options are listed with those of ``envcraft generate``; an option of the same name,
            such as ``--seed`` or ``--corpus``, gets the value that ``envcraft generate`` parsed.
        chosen_by: Names of the parameters that select this generator, such as ``concepts``.
        merge: For a generator with files of its own in a corpus: copies those of the second corpus into the first and
            returns what was copied, such as ``3 answers``, or "". Raises OSError, EnvCraftError.
    """

    command: click.Command
    chosen_by: frozenset[str]
    merge: Callable[[Path, Path], str] | None = None

    @property
    def name(self) -> str:
        return str(self.command.name)
