"""Colours, the way in which blocks are drawn, and what is drawn where."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from random import Random
from typing import TYPE_CHECKING

from envcraft_tetris.draft import Draft

if TYPE_CHECKING:
    from envcraft_tetris.variant import Variant

STYLES = ("flat", "grid", "bevel", "outline", "dot", "stripes")
FIELDS = ("plain", "checks", "columns")
THEMES = ("neon", "pastel", "paper", "earth", "mono")
#: Saturation and brightness of pieces; those of empty cells, of what is around the board, and of its rim.
_TONES = {
    "neon": ((0.85, 1.0), (0.5, 0.09), (0.5, 0.16), (0.3, 0.45)),
    "pastel": ((0.45, 0.95), (0.25, 0.25), (0.3, 0.36), (0.2, 0.6)),
    "paper": ((0.8, 0.7), (0.08, 0.96), (0.14, 0.84), (0.25, 0.5)),
    "earth": ((0.6, 0.8), (0.45, 0.14), (0.4, 0.24), (0.35, 0.5)),
    "mono": ((0.55, 1.0), (0.6, 0.1), (0.6, 0.18), (0.4, 0.45)),
}
_TILES = {
    "flat": (),
    "grid": ("pixels[-1] = pixels[:, -1] = PALETTE[EMPTY]",),
    "bevel": ("pixels[0] = pixels[:, 0] = colour // 2 + 127", "pixels[-1] = pixels[:, -1] = colour // 2"),
    "outline": ("pixels[1:-1, 1:-1] = colour // 3",),
    "dot": ("middle = CELL // 2", "pixels[middle, middle] = 255 - colour"),
    "stripes": ("pixels[1::2] = colour // 2",),
}
_PANEL = 18
_PREVIEW_STEP = 18


@dataclass(frozen=True)
class Look:
    """`hue` is that of the page, `first` that of the first piece, both from 0 to 1."""

    theme: str
    style: str
    field: str
    ghost: bool
    panel: str
    hue: float
    first: float

    @classmethod
    def draw(cls, rng: Random) -> Look:
        return cls(
            theme=rng.choice(THEMES),
            style=rng.choice(STYLES),
            field=rng.choices(FIELDS, (3, 1, 1))[0],
            ghost=rng.random() < 0.25,
            panel=rng.choice(("left", "right")),
            hue=round(rng.random(), 3),
            first=round(rng.random(), 3),
        )

    def write(self, draft: Draft, variant: Variant) -> None:
        self._write_places(draft, variant)
        self._write_colours(draft, variant)
        draft.add(
            "functions",
            """
            def tile(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
                \"\"\"A block of a colour, shape (CELL, CELL, 3).\"\"\"
                <<shade>>
            """,
        )
        blank = "np.tile(colour, (CELL, CELL, 1))"
        shaded = _TILES[self.style]
        draft.add("shade", *((f"pixels = {blank}", *shaded, "return pixels") if shaded else (f"return {blank}",)))
        draft.add("tiles", "TILES[EMPTY] = PALETTE[EMPTY]")
        if self.field != "plain":
            draft.add("tiles", "TILES[EMPTY_TOO] = PALETTE[EMPTY_TOO]")
            pattern = (
                "np.indices((ROWS, COLUMNS)).sum(axis=0)"
                if self.field == "checks"
                else "np.indices((ROWS, COLUMNS))[1]"
            )
            draft.add("tiles", f"SECOND = {pattern} % 2 == 1")
            draft.add("codes", "codes[(codes == EMPTY) & SECOND] = EMPTY_TOO")
        if self.ghost:
            self._write_ghost(draft)

    def _write_ghost(self, draft: Draft) -> None:
        draft.add("story", "A shadow shows where the piece would come down.")
        draft.add(
            "ghost",
            """
            depth = 0
            while self._fits(self.turn, self.row + depth + 1, self.column):
                depth += 1
            for y, x in self._cells():
                if y + depth >= 0:
                    top, left = TOP + CELL * (y + depth), LEFT + CELL * x
                    frame[top : top + CELL, left : left + CELL] = PALETTE[SHADOW]
            """,
        )

    def places(self, variant: Variant) -> tuple[int, int, int, int]:
        """In pixels: the side of a cell, the top and the left of the board, and the left of the panel."""
        board, preview, holds = variant.board, variant.supply.preview, variant.controls.holds
        room = 80 - (_PANEL if preview or holds else 0)
        cell = min(7, 74 // board.rows, room // board.columns)
        width = cell * board.columns
        top = 5 + (75 - cell * board.rows) // 2
        if not (preview or holds):
            left = (84 - width) // 2
        elif self.panel == "left":
            left = 2 + _PANEL + (room - width) // 2
        else:
            left = 2 + (room - width) // 2
        return cell, top, left, 3 if self.panel == "left" else 84 - _PANEL + 1

    def _write_places(self, draft: Draft, variant: Variant) -> None:
        preview, holds = variant.supply.preview, variant.controls.holds
        cell, top, left, panel = self.places(variant)
        draft.add("constants", "# In pixels, from the top left corner.", f"CELL, TOP, LEFT = {cell}, {top}, {left}")
        if not (preview or holds):
            return
        draft.add("constants", f"PANEL = {panel}")
        draft.add(
            "panel",
            """
            def _paint_small(self, picture: NDArray[np.uint8], kind: int, top: int) -> None:
                for down, across in TURNS[kind][0]:
                    y, x = top + 3 * down, PANEL + 3 * across
                    picture[y : y + 2, x : x + 2] = PALETTE[<<small>>]
            """,
        )
        draft.add("small", "kind % COLOURS + 1" if variant.clearing.rule == "colour" else "kind + 1")
        if preview:
            draft.add("paint", "for place, kind in enumerate(self.queue):")
            draft.add("paint", f"    self._paint_small(picture, kind, 8 + {_PREVIEW_STEP} * place)")
        if holds:
            draft.add("paint", "if self.held is not None:", "    self._paint_small(picture, self.held, 66)")

    def palette(self, variant: Variant) -> tuple[dict[str, int], list[str]]:
        """The numbers of the colours that have names, and every colour in hexadecimal in the order of the numbers."""
        pieces, empty, page, rim = _TONES[self.theme]
        count = variant.clearing.colours or len(variant.pieces.art)
        colours = [_hex(self.hue, *empty)]
        for number in range(count):
            hue, bright = self.first + number / count, pieces[1] * (1 - 0.12 * (number % 2))
            if self.theme == "mono":
                hue, bright = self.hue, pieces[1] * (0.35 + 0.65 * (number + 1) / count)
            colours.append(_hex(hue, pieces[0], bright))
        numbers = {"EMPTY": 0}
        dark = empty[1] < 0.5
        for name, wanted, colour in (
            ("WALL", bool(variant.board.walls), _hex(self.hue, 0.15, 0.6)),
            ("GARBAGE", variant.garbage.any and variant.clearing.rule != "colour", _hex(self.hue, 0.05, 0.5)),
            ("EMPTY_TOO", self.field != "plain", _hex(self.hue, empty[0], empty[1] + (0.07 if dark else -0.07))),
            ("SHADOW", self.ghost, _hex(self.hue, 0.2, 0.34 if dark else 0.75)),
            ("PAGE", True, _hex(self.hue, *page)),
            ("RIM", True, _hex(self.hue, *rim)),
            ("BAR", variant.ending.goal != "endless" or bool(variant.ending.ceiling), _hex(self.hue + 0.5, 0.7, 0.9)),
        ):
            if wanted:
                numbers[name] = len(colours)
                colours.append(colour)
        return numbers, colours

    def _write_colours(self, draft: Draft, variant: Variant) -> None:
        numbers, colours = self.palette(variant)
        draft.add("names", ", ".join(numbers))
        draft.add("numbers", ", ".join(map(str, numbers.values())))
        draft.add("colours", "# One hexadecimal red-green-blue triple for each of these numbers.")
        # No line is longer than 120 characters.
        if len(colours) <= 14:
            draft.add("colours", f'COLOURS_IN_HEX = "{" ".join(colours)}"')
        else:
            lines = [" ".join(colours[start : start + 16]) for start in range(0, len(colours), 16)]
            draft.add("colours", "COLOURS_IN_HEX = (", *(f'    "{line} "' for line in lines), ")")
        draft.add("colours", "PALETTE = np.frombuffer(bytes.fromhex(COLOURS_IN_HEX), dtype=np.uint8).reshape(-1, 3)")


def _hex(hue: float, saturation: float, brightness: float) -> str:
    red, green, blue = colorsys.hsv_to_rgb(hue % 1.0, saturation, min(1.0, brightness))
    return f"{round(255 * red):02x}{round(255 * green):02x}{round(255 * blue):02x}"
