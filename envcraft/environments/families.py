"""Families: programs that generate any number of environments; ``envcraft generate --family`` selects one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
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
        has_difficulty: Whether :meth:`generate` takes a difficulty.
    """

    name: str
    summary: str
    has_difficulty: bool = False

    @abstractmethod
    def generate(self, count: int, seed: int, difficulty: float | None = None) -> Iterator[Generated]:
        """Generate environments.

        Args:
            count: How many; a smaller number gives the first of the same environments.
            seed: The same seed gives the same environments.
            difficulty: From 0 to 1 for environments that are all equally difficult; with a higher difficulty a good
                player needs more steps and random play wins less. None lets the family draw one for each
                environment. A family without :attr:`has_difficulty` always gets None.

        Returns:
            The environments, in order.
        """

    def where(self, axes: Mapping[str, str]) -> Family:
        """The environments of this family that have these values on some axes.

        Args:
            axes: The values by the dotted names of the axes, as written on a command line: ``{"board.rows": "16"}``.

        Returns:
            A family of the same name that generates these environments alone.

        Raises:
            UsageError: The family has no such axis, or an axis has no such value.
        """
        raise UsageError(f"the family {self.name} has no axis that --where can fix")

    def kind(self, metadata: dict[str, Any]) -> str:
        """A short name of the kind of environment with this metadata, by which reports group environments; "" if the
        family has one kind.
        """
        return ""

    def simulate(self, generated: Sequence[Generated], autoreset_mode: AutoresetMode, copy: bool) -> VectorEnv:
        """Make a vector that plays these environments in this process without running their files.

        Frames, rewards, flags and infos are the same bit for bit. ``envcraft.make_vec(..., fast=True)`` calls this.

        A vector may also advise learners: ``advise(wanted)`` takes the environments to advise, bool [num_envs], and
        returns the probabilities with which a player who sees the states would choose the joint actions, [num_envs,
        actions].

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


def axes_from(options: Sequence[str]) -> dict[str, str]:
    """The axes of ``--where AXIS=VALUE``, given once for each axis. Raises UsageError."""
    axes: dict[str, str] = {}
    for option in options:
        axis, equals, value = (part.strip() for part in option.partition("="))
        if not (axis and equals and value):
            raise UsageError(f"--where {option} is not AXIS=VALUE, such as board.rows=16")
        if axis in axes:
            raise UsageError(f"--where gives {axis} twice: {axes[axis]} and {value}")
        axes[axis] = value
    return axes


def families_named(names: str, difficulty: float | None = None, axes: Mapping[str, str] | None = None) -> list[Family]:
    """The families with these names.

    Args:
        names: One name, or several with commas between them.
        difficulty: The difficulty that they are to have, if any.
        axes: The values that some axes are to have; see :meth:`Family.where`.

    Raises:
        UsageError: A name is unknown or repeated, or its family has no difficulty or no such axis.
    """
    found = [family_named(name.strip()) for name in names.split(",")]
    known: set[str] = set()
    for family in found:
        if family.name in known:
            raise UsageError(f"--family {names} names {family.name} twice")
        known.add(family.name)
        if difficulty is not None and not family.has_difficulty:
            able = [other.name for other in offered("envcraft_families") if other.has_difficulty]
            others = f"the families with a difficulty are {', '.join(able)}" if able else "no family has one"
            raise UsageError(f"the family {family.name} has no --difficulty; {others}")
    return [family.where(axes) for family in found] if axes else found


def simulate(sources: Sequence[EnvSource], autoreset_mode: AutoresetMode, copy: bool) -> VectorEnv:
    """Make a vector of these environments by the simulator of the family that generated them.

    Raises:
        UsageError: They are not of one family, the contract adapts what a file does, or the family has no simulator.
    """
    families = {source.origin.get("family", ""): source.name for source in sources}
    if "" in families:
        raise UsageError(
            f"fast=True needs environments that `envcraft generate` wrote into a corpus, not {families['']}"
        )
    if len(families) > 1:
        names = ", ".join(f"{name} of {family}" for family, name in families.items())
        raise UsageError(f"fast=True needs environments of one family, not of several: {names}")
    for source in sources:
        if source.contract.adapter:
            raise UsageError(
                f"fast=True plays {source.name} without an adapter, but the contract {source.contract.name} has one: "
                "choose another contract, or leave fast out"
            )
    generated = [Generated(one.name.removesuffix(".py"), one.source.decode(), one.origin) for one in sources]
    return family_named(next(iter(families))).simulate(generated, autoreset_mode, copy)
