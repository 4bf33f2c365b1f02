"""Families: environments that a program writes, any number of them; ``envcraft generate --family`` names one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from envcraft.errors import UsageError

if TYPE_CHECKING:
    from envcraft.using.vector import Running


@dataclass(frozen=True)
class Generated:
    """An environment that was written.

    Attributes:
        name: that of its file without ``.py``: a Python identifier, and another one for each of a family and seed.
        source: the text of the file.
        metadata: plain data that says how it came about; a corpus keeps it.
    """

    name: str
    source: str
    metadata: dict[str, Any] = field(default_factory=dict)


class Family(ABC):
    """Writes environments.

    Attributes:
        name: how ``--family`` names it.
        summary: one line for ``envcraft generate --list``.
    """

    name: str
    summary: str

    @abstractmethod
    def generate(self, count: int, seed: int) -> Iterator[Generated]:
        """So many environments; the same for the same seed, and a smaller `count` gives the first of them."""

    def kind(self, metadata: dict[str, Any]) -> str:
        """In a few words, which of the kinds that reports tell apart an environment with such metadata is; "" where all
        are one.
        """
        return ""

    def simulate(self, generated: Sequence[Generated]) -> Running:
        """A program that plays these environments, one after the other in this list, as their files would; frames,
        rewards, flags and infos are the same bit for bit. ``envcraft.make_vec(..., fast=True)`` asks for it.

        Raises UsageError where there is none, and where a source is not what the family writes for its metadata.
        """
        raise UsageError(f"the family {self.name} has no program that plays its environments: leave fast out")
