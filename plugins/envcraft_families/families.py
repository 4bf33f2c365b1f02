"""The families of this package."""

from __future__ import annotations

from envcraft_families.breakout import Breakout
from envcraft_families.maze import Maze
from envcraft_families.shooter import Shooter
from envcraft_families.snake import Snake
from envcraft_families.variant import VariantFamily


def families() -> list[VariantFamily]:
    """All families, in the order of their names."""
    return [
        VariantFamily("breakout", "a paddle, a ball and bricks: sides, walls, aims, serves and goals", Breakout),
        VariantFamily("maze", "keys and doors in mazes: layouts, locks, hazards, controls and goals", Maze),
        VariantFamily("shooter", "a ship with little ammunition: enemies, fire, weapons, motions and sides", Shooter),
        VariantFamily("snake", "a snake that grows: fields, steering, paces, meals, hunger and goals", Snake),
    ]
