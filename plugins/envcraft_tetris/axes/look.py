"""Colours, the style of blocks, and the layout of the frame."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.rules import Rules

STYLES = ("flat", "grid", "bevel", "outline", "dot", "stripes")
FIELDS = ("plain", "checks", "columns")
THEMES = ("neon", "pastel", "paper", "earth", "mono")
#: Saturation and brightness of the pieces, the empty cells, the page around the board, and the rim.
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
    """The look. `hue` is the hue of the page and `first` that of the first piece, both in [0, 1]."""

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

    def write(self, code: SourceBuilder, rules: Rules) -> None:
        self._write_layout(code, rules)
        self._write_colours(code, rules)
        code.add(
            "functions",
            """
            def tile(colour: NDArray[np.uint8]) -> NDArray[np.uint8]:
                \"\"\"A block of a colour, shape (CELL, CELL, 3).\"\"\"
                <<shade>>
            """,
        )
        blank = "np.tile(colour, (CELL, CELL, 1))"
        shaded = _TILES[self.style]
        code.add("shade", *((f"pixels = {blank}", *shaded, "return pixels") if shaded else (f"return {blank}",)))
        code.add("tiles", "TILES[EMPTY] = PALETTE[EMPTY]")
        if self.field != "plain":
            code.add("tiles", "TILES[EMPTY_TOO] = PALETTE[EMPTY_TOO]")
            pattern = (
                "np.indices((ROWS, COLUMNS)).sum(axis=0)"
                if self.field == "checks"
                else "np.indices((ROWS, COLUMNS))[1]"
            )
            code.add("tiles", f"SECOND = {pattern} % 2 == 1")
            code.add("codes", "codes[(codes == EMPTY) & SECOND] = EMPTY_TOO")
        if self.ghost:
            self._write_ghost(code)

    def _write_ghost(self, code: SourceBuilder) -> None:
        code.add("story", "A shadow shows where the piece would come down.")
        code.add(
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

    def layout(self, rules: Rules) -> tuple[int, int, int, int]:
        """The side of a cell, the top and left of the board, and the left of the panel, in pixels."""
        board, preview, holds = rules.board, rules.supply.preview, rules.controls.holds
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

    def _write_layout(self, code: SourceBuilder, rules: Rules) -> None:
        preview, holds = rules.supply.preview, rules.controls.holds
        cell, top, left, panel = self.layout(rules)
        code.add("constants", "# In pixels, from the top left corner.", f"CELL, TOP, LEFT = {cell}, {top}, {left}")
        if not (preview or holds):
            return
        code.add("constants", f"PANEL = {panel}")
        code.add(
            "panel",
            """
            def _paint_small(self, picture: NDArray[np.uint8], kind: int, top: int) -> None:
                for down, across in TURNS[kind][0]:
                    y, x = top + 3 * down, PANEL + 3 * across
                    picture[y : y + 2, x : x + 2] = PALETTE[<<small>>]
            """,
        )
        code.add("small", "kind % COLOURS + 1" if rules.clearing.rule == "colour" else "kind + 1")
        if preview:
            code.add("paint", "for place, kind in enumerate(self.queue):")
            code.add("paint", f"    self._paint_small(picture, kind, 8 + {_PREVIEW_STEP} * place)")
        if holds:
            code.add("paint", "if self.held is not None:", "    self._paint_small(picture, self.held, 66)")

    def palette(self, rules: Rules) -> tuple[dict[str, int], list[str]]:
        """The indices of the named colours, and all colours in hexadecimal in the order of their indices."""
        pieces, empty, page, rim = _TONES[self.theme]
        count = rules.clearing.colours or len(rules.pieces.art)
        colours = [_hex(self.hue, *empty)]
        for number in range(count):
            hue, bright = self.first + number / count, pieces[1] * (1 - 0.12 * (number % 2))
            if self.theme == "mono":
                hue, bright = self.hue, pieces[1] * (0.35 + 0.65 * (number + 1) / count)
            colours.append(_hex(hue, pieces[0], bright))
        numbers = {"EMPTY": 0}
        dark = empty[1] < 0.5
        for name, wanted, colour in (
            ("WALL", bool(rules.board.walls), _hex(self.hue, 0.15, 0.6)),
            ("GARBAGE", rules.garbage.any and rules.clearing.rule != "colour", _hex(self.hue, 0.05, 0.5)),
            ("EMPTY_TOO", self.field != "plain", _hex(self.hue, empty[0], empty[1] + (0.07 if dark else -0.07))),
            ("SHADOW", self.ghost, _hex(self.hue, 0.2, 0.34 if dark else 0.75)),
            ("PAGE", True, _hex(self.hue, *page)),
            ("RIM", True, _hex(self.hue, *rim)),
            ("BAR", rules.ending.goal != "endless" or bool(rules.ending.ceiling), _hex(self.hue + 0.5, 0.7, 0.9)),
        ):
            if wanted:
                numbers[name] = len(colours)
                colours.append(colour)
        return numbers, colours

    def _write_colours(self, code: SourceBuilder, rules: Rules) -> None:
        numbers, colours = self.palette(rules)
        code.add("names", ", ".join(numbers))
        code.add("numbers", ", ".join(map(str, numbers.values())))
        code.add("colours", "# One hexadecimal red-green-blue triple for each of these numbers.")
        # Lines have at most 120 characters.
        if len(colours) <= 14:
            code.add("colours", f'COLOURS_IN_HEX = "{" ".join(colours)}"')
        else:
            lines = [" ".join(colours[start : start + 16]) for start in range(0, len(colours), 16)]
            code.add("colours", "COLOURS_IN_HEX = (", *(f'    "{line} "' for line in lines), ")")
        code.add("colours", "PALETTE = np.frombuffer(bytes.fromhex(COLOURS_IN_HEX), dtype=np.uint8).reshape(-1, 3)")


def _hex(hue: float, saturation: float, brightness: float) -> str:
    red, green, blue = colorsys.hsv_to_rgb(hue % 1.0, saturation, min(1.0, brightness))
    return f"{round(255 * red):02x}{round(255 * green):02x}{round(255 * blue):02x}"
