"""Looks: colours, sprites, and the textures of floors and walls."""

from __future__ import annotations

import colorsys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from random import Random

#: Rows of five marks.
SPRITES = {
    "GEM": ("00100 01110 11111 01110 00100", "01010 11111 11111 01110 00100", "01110 11011 10001 11011 01110"),
    "BEACON": ("11111 10001 10101 10001 11111", "00100 01110 11011 01110 00100", "10101 01110 11111 01110 10101"),
    "KEY": ("01100 10010 01100 00100 00110", "11000 11111 11001 00010 00000", "01110 01010 01110 00100 01100"),
    "DOOR": ("01110 11111 11111 11011 11111", "11111 10001 10101 10001 10001", "01110 10001 10001 10011 10001"),
    "SWITCH": ("00000 01110 01110 01110 00000", "11111 11011 10101 11011 11111", "00100 00100 11111 00100 00100"),
    "DEPOT": ("00100 01110 11111 11011 11011", "11111 11111 10001 10001 10001", "10001 11011 10101 10001 11111"),
    "PARCEL": ("11111 11011 10001 11011 11111", "01110 11111 11111 11111 01110", "11011 11011 00000 11011 11011"),
    "CHICK": ("00110 01111 11110 01110 01010", "01110 11111 01110 00100 01010", "00000 01100 11111 01110 01010"),
    "SHEEP": ("01110 11111 11111 01010 01010", "00011 11111 11110 11110 10010", "11011 11111 01110 11111 10001"),
    "MARK": ("01110 10001 10101 10001 01110", "10001 01010 00100 01010 10001", "11111 10001 10001 10001 11111"),
    "FRIEND": ("01010 11111 11111 01110 00100", "01110 10101 11111 10001 01110", "00100 01110 00100 01110 01010"),
    "FRUIT": ("00010 00100 01110 11111 01110", "01010 00100 11111 11111 01110", "00100 11111 11111 11111 01110"),
    "CRATE": ("11111 10001 10001 10001 11111", "11111 11011 10101 11011 11111", "11111 10111 11111 11101 11111"),
    "RING": ("10001 00000 00100 00000 10001", "00000 01010 00100 01010 00000", "11011 10001 00000 10001 11011"),
    "CAR": ("01100 11111 11111 01010 00000", "00000 01110 11111 11111 01010", "11110 11111 11111 11110 01010"),
    "BODY": ("01110 11111 11111 11111 01110", "11111 11111 11111 11111 11111", "00000 01110 01110 01110 00000"),
    "FOE": ("10101 11111 10101 11111 01010", "01110 10101 11111 10101 10101", "10001 01110 11111 01110 10001"),
    "FLAME": ("00100 01100 01110 11111 01110", "01000 01010 11110 11111 01110", "00100 01010 11011 11111 01110"),
    "SPIKE": ("00000 00100 00100 01110 11111", "10001 01010 00100 01010 10001", "00100 10101 01110 10101 00100"),
    "HERO": (
        "01110 01110 11111 01110 01010",
        "00100 01110 11111 11111 01010",
        "01110 11111 11111 11111 01110",
        "11111 10101 11111 11111 01010",
        "01010 01110 11111 01110 00100",
    ),
}
#: Code that draws on `floor`, a view of the picture.
TEXTURES = {
    "plain": "",
    "checks": "for part in range(CELL):\n    floor[part :: 2 * CELL, ::2] = PALETTE[1]",
    "tiles": "floor[::CELL] = PALETTE[1]\nfloor[:, ::CELL] = PALETTE[1]",
    "dots": "floor[CELL // 2 :: CELL, CELL // 2 :: CELL] = PALETTE[1]",
    "rows": "floor[CELL - 1 :: CELL] = PALETTE[1]",
    "columns": "floor[:, :: CELL] = PALETTE[1]",
    "weave": "floor[::4, ::2] = PALETTE[1]\nfloor[2::4, 1::2] = PALETTE[1]",
    "lawn": "for part in range(CELL):\n    floor[:, part :: 2 * CELL] = PALETTE[1]",
}
_WALL = "picture[top : top + CELL, left : left + CELL] = PALETTE[2]"
#: Code that draws a wall at `top` and `left`.
WALLS = {
    "flat": _WALL,
    "blocks": f"{_WALL}\npicture[top, left : left + CELL] = PALETTE[7]",
    "bevel": f"{_WALL}\npicture[top + 1 : top + CELL - 1, left + 1 : left + CELL - 1] = PALETTE[2] // 2",
    "posts": "picture[top + 1 : top + CELL - 1, left + 1 : left + CELL - 1] = PALETTE[2]",
    "bricks": f"{_WALL}\npicture[top + CELL // 2, left : left + CELL] = PALETTE[0]",
}
#: What the colours of a palette are for, by number.
ROLES = "floor, floor pattern, walls, avatar, what counts now, what counts later, danger, ink, margin"


@dataclass(frozen=True)
class Look:
    """How a game looks.

    Attributes:
        palette: Nine colours in hexadecimal digits, for the :data:`ROLES`.
        texture: A name of :data:`TEXTURES`.
        wall: A name of :data:`WALLS`.
        shapes: For each sprite the number of its shape.
    """

    palette: str
    texture: str
    wall: str
    shapes: dict[str, int]

    @classmethod
    def draw(cls, rng: Random, sprites: Mapping[str, Sequence[str]]) -> Look:
        """Draw a look, with one shape for each sprite."""
        hue, dark = rng.random(), rng.random() < 0.6
        floor, pattern, wall = (0.12, 0.2, 0.5) if dark else (0.92, 0.8, 0.45)
        ink, margin = (0.97, 0.25) if dark else (0.05, 0.65)
        lively = 1.0 if dark else 0.75
        turn = rng.uniform(0.28, 0.4)
        tones = [
            (hue, 0.5 if dark else 0.12, floor),
            (hue + 0.04, 0.45 if dark else 0.2, pattern),
            (hue + rng.uniform(-0.1, 0.1), rng.uniform(0.2, 0.6), wall),
            (hue + turn, 0.75, lively),
            (hue + 2 * turn, 0.85, lively),
            (hue + 2 * turn, 0.6, 0.62),
            (0.0 if 0.08 < (hue + turn) % 1 < 0.92 else 0.83, 0.95, 0.95 if dark else 0.8),
            (hue, 0.05, ink),
            (hue, 0.3, margin),
        ]
        channels = [round(255 * part) for tone in tones for part in colorsys.hsv_to_rgb(tone[0] % 1, *tone[1:])]
        texture, walls = rng.choice(sorted(TEXTURES)), rng.choice(sorted(WALLS))
        shapes = {name: rng.randrange(len(found)) for name, found in sprites.items()}
        return cls(bytes(channels).hex(), texture, walls, shapes)
