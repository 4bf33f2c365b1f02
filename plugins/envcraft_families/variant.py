"""What the four families share: variants of a game, and a family that draws them."""

from __future__ import annotations

import dataclasses
import itertools
import re
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import Any, ClassVar, Self

from envcraft.environments.families import Family, Generated
from envcraft.environments.source_builder import SourceBuilder, paragraph
from envcraft_families.look import Look
from envcraft_families.skeleton import SKELETON

#: The lowest difficulty that a family draws by itself. Below it, random play wins some games often.
EASIEST = 0.4


@dataclass(frozen=True)
class Variant(ABC):
    """One value for each axis. All fields but the look are rules.

    Attributes:
        axes: What each axis can be, for the documentation.
    """

    difficulty: float
    look: Look

    axes: ClassVar[dict[str, str]]

    @classmethod
    @abstractmethod
    def draw(cls, rng: Random, difficulty: float) -> Self:
        """Draw compatible values at random. The difficulty, from 0 to 1, changes numbers but no choice."""

    @property
    @abstractmethod
    def title(self) -> str:
        """A short name made of the distinctive rules."""

    @abstractmethod
    def write_rules(self, code: SourceBuilder) -> None:
        """Add the code and the documentation of every rule to a source."""

    @property
    def rules(self) -> tuple[Any, ...]:
        """The values of the rules alone. Two variants with equal rules are the same game."""
        return tuple(getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "look")

    def write(self, class_name: str) -> str:
        """The source of the environment, as a class with this name."""
        code = SourceBuilder()
        self.write_rules(code)
        code.add("title", f"{self.title}.")
        code.add("summary", f"{self.title}.")
        code.add("class", class_name)
        if not (paid := code.take("step_reward")):
            paid = ["0.0"]
        code.add("step_reward", *paid)
        story, aim, controls, rewards = (code.take(slot) for slot in ("story", "aim", "controls", "paid"))
        parts = (
            paragraph(*story),
            paragraph("Goal:", *aim),
            paragraph("Controls:", *controls),
            paragraph(f"Rewards: {', '.join(rewards)}."),
        )
        code.add("about", "\n\n".join(parts))
        return re.sub(r"\n{4,}", "\n\n\n", code.render(SKELETON)).rstrip() + "\n"


class VariantFamily(Family):
    """A family whose environments are variants of one game.

    Args:
        name: The name of the family.
        summary: One line for the list of families.
        variant: The class that draws and writes a variant.
    """

    has_difficulty = True

    def __init__(self, name: str, summary: str, variant: type[Variant]) -> None:
        self.name, self.summary, self.variant = name, summary, variant

    def generate(self, count: int, seed: int, difficulty: float | None = None) -> Iterator[Generated]:
        """Generate `count` variants with distinct rules. Each is named after the number of its draw."""
        prefix = f"{self.name}_{seed}"
        if difficulty is not None:
            # A difficulty of 0.125 gives names with d12_5.
            prefix += f"_d{100 * difficulty:g}".replace(".", "_")
        known: set[tuple[Any, ...]] = set()
        for number in itertools.count():
            if len(known) == count:
                return
            # A generator for each draw: the same number has the same choices at every difficulty.
            rng = Random(f"{self.name} {seed} {number}")
            drawn = round(rng.uniform(EASIEST, 1), 2)
            variant = self.variant.draw(rng, drawn if difficulty is None else difficulty)
            if variant.rules in known:
                continue
            known.add(variant.rules)
            source = variant.write(f"{self.name.capitalize()}{number:04}")
            yield Generated(f"{prefix}_{number:04}", source, {"axes": dataclasses.asdict(variant)})


def between(low: float, high: float, difficulty: float) -> float:
    """The value at a difficulty, from `low` at 0 to `high` at 1."""
    return low + (high - low) * difficulty
