"""Colours and the style of tiles."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder

THEMES = ("night", "neon", "paper", "earth", "pastel")
STYLES = ("flat", "bevel", "outline", "dot", "stripes")
#: Saturation and brightness of the page, of the ground, of walls, and of things.
_TONES = {
    "night": ((0.5, 0.12), (0.4, 0.22), (0.2, 0.5), (0.65, 0.95)),
    "neon": ((0.6, 0.06), (0.5, 0.13), (0.5, 0.45), (0.9, 1.0)),
    "paper": ((0.12, 0.82), (0.06, 0.97), (0.2, 0.5), (0.85, 0.75)),
    "earth": ((0.45, 0.18), (0.35, 0.3), (0.3, 0.52), (0.6, 0.88)),
    "pastel": ((0.25, 0.34), (0.2, 0.46), (0.1, 0.68), (0.4, 1.0)),
}
_TILES = {
    "flat": (),
    "bevel": ("pixels[0] = pixels[:, 0] = colour // 2 + 127", "pixels[-1] = pixels[:, -1] = colour // 2"),
    "outline": ("pixels[1:-1, 1:-1] = colour // 2",),
    "dot": ("pixels[height // 2, width // 2] = 255 - colour",),
    "stripes": ("pixels[1::2] = colour // 4 * 3",),
}


#: The sides of the frame at which a player can be, with the code that turns the frame there.
SIDES = {
    "bottom": "",
    "top": "frame = frame[::-1].copy()",
    "left": "frame = frame.transpose(1, 0, 2)[:, ::-1].copy()",
    "right": "frame = frame.transpose(1, 0, 2).copy()",
}


@dataclass(frozen=True)
class Look:
    """The look. `hue` is that of the ground, in [0, 1]; the hues of things spread over the circle from there."""

    theme: str
    style: str
    hue: float

    @classmethod
    def draw(cls, rng: Random) -> Look:
        return cls(rng.choice(THEMES), rng.choice(STYLES), round(rng.random(), 3))

    def write_colours(self, code: SourceBuilder, things: Sequence[str]) -> None:
        """Name the colours ``PAGE``, ``GROUND``, ``WALL`` and those of some things in the slot `colours`."""
        page, ground, wall, thing = _TONES[self.theme]
        tones = [(self.hue, *page), (self.hue, *ground), (self.hue, *wall)]
        # Neighbours on the circle of hues also differ in brightness.
        for number in range(len(things)):
            hue = self.hue + 0.08 + (number + 0.5) / len(things) * 0.84
            tones.append((hue, thing[0], thing[1] * (1 - 0.18 * (number % 2))))
        names = ("PAGE", "GROUND", "WALL", *things)
        code.add("colours", "# One hexadecimal red-green-blue triple for each of the names.")
        code.add("colours", f'COLOURS_IN_HEX = "{" ".join(_hex(*tone) for tone in tones)}"')
        code.add("colours", "COLOURS = np.frombuffer(bytes.fromhex(COLOURS_IN_HEX), dtype=np.uint8).reshape(-1, 3)")
        code.add("colours", f"{', '.join(names)} = COLOURS")

    def write_tile(self, code: SourceBuilder) -> None:
        """Add the function ``tile``, which draws a block of a colour in this style."""
        code.add(
            "functions",
            """
            def tile(colour: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint8]:
                \"\"\"A block of a colour, shape (height, width, 3).\"\"\"
                <<shade>>
            """,
        )
        blank, shaded = "np.tile(colour, (height, width, 1))", _TILES[self.style]
        code.add("shade", *((f"pixels = {blank}", *shaded, "return pixels") if shaded else (f"return {blank}",)))


def _hex(hue: float, saturation: float, brightness: float) -> str:
    red, green, blue = colorsys.hsv_to_rgb(hue % 1.0, saturation, min(1.0, brightness))
    return f"{round(255 * red):02x}{round(255 * green):02x}{round(255 * blue):02x}"
