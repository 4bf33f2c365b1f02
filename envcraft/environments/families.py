"""Families: programs that generate any number of environments; ``envcraft generate --family`` selects one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from envcraft.errors import UsageError
from envcraft.registry import lookup, offered

if TYPE_CHECKING:
    from gymnasium.vector import AutoresetMode, VectorEnv

    from envcraft.environments.sources import EnvSource


@dataclass(frozen=True)
class Generated:
    """A generated environment.

    Attributes:
        name: Name of the file without ``.py``: a Python identifier, unique within a family and seed.
        source: Text of the file.
        metadata: Plain data that describes how it was generated; a corpus stores it.
    """

    name: str
    source: str
    metadata: dict[str, Any] = field(default_factory=dict)


class Family(ABC):
    """Generates environments.

    Attributes:
        name: The value of ``--family``.
        summary: One line for ``envcraft generate --list``.
    """

    name: str
    summary: str

    @abstractmethod
    def generate(self, count: int, seed: int) -> Iterator[Generated]:
        """Generate environments.

        Args:
            count: How many; a smaller number gives the first of the same environments.
            seed: The same seed gives the same environments.

        Returns:
            The environments, in order.
        """

    def kind(self, metadata: dict[str, Any]) -> str:
        """A short name of the kind of environment with this metadata, by which reports group environments; "" if the
        family has one kind.
        """
        return ""

    def simulate(self, generated: Sequence[Generated], autoreset_mode: AutoresetMode, copy: bool) -> VectorEnv:
        """Make a vector that plays these environments in this process without running their files.

        Frames, rewards, flags and infos are the same bit for bit. ``envcraft.make_vec(..., fast=True)`` calls this.

        Args:
            generated: The environments, one for each row of the vector.
            autoreset_mode: What follows the end of an episode.
            copy: Return copies of the observations instead of the memory that the next step overwrites.

        Returns:
            A Gymnasium vector whose ``metadata`` has the autoreset mode.

        Raises:
            UsageError: The family has no simulator, or a source is not what it generates for its metadata.
        """
        raise UsageError(f"the family {self.name} has no simulator for its environments: leave fast out")


def family_named(name: str) -> Family:
    """The family with this name. Raises UsageError, which names the nearest."""
    found: Family = lookup("family", name, {family.name: family for family in offered("envcraft_families")})
    return found


def simulate(sources: Sequence[EnvSource], autoreset_mode: AutoresetMode, copy: bool) -> VectorEnv:
    """Make a vector of these environments by the simulator of the family that generated them.

    Raises:
        UsageError: They are not of one family, the contract adapts what a file does, or the family has no simulator.
    """
    families = {source.origin.get("family", ""): source.name for source in sources}
    if "" in families:
        raise UsageError(f"fast=True plays what `envcraft generate` wrote into a corpus, and not {families['']}")
    if len(families) > 1:
        names = ", ".join(f"{name} of {family}" for family, name in families.items())
        raise UsageError(f"fast=True plays environments of one family, and these are of several: {names}")
    for source in sources:
        if source.contract.adapter:
            raise UsageError(
                f"fast=True plays {source.name} as its file does, and the contract {source.contract.name} adapts that: "
                "choose another contract, or leave fast out"
            )
    generated = [Generated(one.name.removesuffix(".py"), one.source.decode(), one.origin) for one in sources]
    return family_named(next(iter(families))).simulate(generated, autoreset_mode, copy)
