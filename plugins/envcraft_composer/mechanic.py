"""Mechanics and the type system that says which of them fit together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from random import Random

#: Module constants of a game, by name. They also fill the fields in braces of the description.
Constants = dict[str, object]


def _no_constants(rng: Random, level: float) -> Constants:
    return {}


@dataclass(frozen=True)
class Mechanic:
    """A part of a game.

    Attributes:
        name: Unique among all mechanics.
        about: Sentences for the docstring of a game.
        gives: Traits that this part adds to a game.
        needs: Traits that other parts of the game must have.
        bars: Traits that no other part of the game may have.
        parts: Code by slot of the skeleton.
        sprites: The names of its pictures.
        shapes: Pictures of its own: by name, shapes of five rows of five marks.
        draw: Draws its constants from a generator and the level of difficulty, from 0 to 1.
        pace: Factor on the steps that a player needs.
        area: For goals that take in the whole world: the steps for each cell.
        controls: Sentence about the controls; only avatars have one.
        actions: The joint actions that differ; only avatars have them.
    """

    name: str
    about: str
    gives: frozenset[str] = frozenset()
    needs: frozenset[str] = frozenset()
    bars: frozenset[str] = frozenset()
    parts: Mapping[str, str] = field(default_factory=dict)
    sprites: tuple[str, ...] = ()
    shapes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    draw: Callable[[Random, float], Constants] = _no_constants
    pace: float = 1.0
    area: float = 0.0
    controls: str = ""
    actions: tuple[tuple[int, int, int], ...] = ()


def traits(*names: str) -> frozenset[str]:
    """A set of traits."""
    return frozenset(names)


def fits(mechanics: Sequence[Mechanic]) -> bool:
    """Whether each mechanic finds the traits that it needs among the others, and none that it bars."""
    for mechanic in mechanics:
        given = frozenset().union(*(other.gives for other in mechanics if other is not mechanic))
        if not mechanic.needs <= given or mechanic.bars & given:
            return False
    return True


def scaled(low: float, high: float, level: float) -> int:
    """A whole number between two ends by the level of difficulty."""
    return round(low + (high - low) * level)


def goal_methods(remaining: str, targets: str) -> dict[str, str]:
    """The methods that each goal defines: how much is left to do, and the places that count now."""
    return {
        "method:remaining": f"\ndef _remaining(self) -> int:\n    return {remaining}\n",
        "method:targets": f"\ndef _targets(self) -> list[tuple]:\n    return {targets}\n",
    }
