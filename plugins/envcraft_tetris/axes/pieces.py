"""The set of pieces."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder

Piece = tuple[str, ...]

#: The rows of the square box of each named piece in its entry orientation.
_ART = {
    "dot": "#",
    "domino": ".. ##",
    "three": "... ### ...",
    "corner": "#. ##",
    "I": ".... #### .... ....",
    "O": "## ##",
    "T": ".#. ### ...",
    "S": ".## ##. ...",
    "Z": "##. .## ...",
    "J": "#.. ### ...",
    "L": "..# ### ...",
    "F5": ".## ##. .#.",
    "I5": "..... ..... ##### ..... .....",
    "L5": "...# #### .... ....",
    "J5": "#... #### .... ....",
    "N5": "##.. .### .... ....",
    "P5": "##. ### ...",
    "Q5": ".## ### ...",
    "T5": "### .#. .#.",
    "U5": "#.# ### ...",
    "V5": "#.. #.. ###",
    "W5": "#.. ##. .##",
    "X5": ".#. ### .#.",
    "Y5": ".#.. #### .... ....",
    "Z5": "##. .#. .##",
}
_TETROMINOES = ("I", "O", "T", "S", "Z", "J", "L")
_TROMINOES = ("three", "corner")
_PENTOMINOES = tuple(name for name in _ART if name.endswith("5"))

SETS = ("tetrominoes", "some tetrominoes", "trominoes", "small pieces", "pentominoes", "mixed pieces", "custom pieces")


@dataclass(frozen=True)
class Pieces:
    """`family` is one of :data:`SETS`; `art` holds the rows of each piece, with "#" for a cell and "." for none."""

    family: str
    art: tuple[Piece, ...]

    @classmethod
    def draw(cls, rng: Random) -> Pieces:
        family = rng.choices(SETS, (5, 4, 2, 2, 3, 4, 4))[0]
        names: tuple[str, ...]
        if family == "custom pieces":
            return cls(family, _custom(rng, rng.randint(4, 7)))
        if family == "tetrominoes":
            names = _TETROMINOES
        elif family == "some tetrominoes":
            names = tuple(rng.sample(_TETROMINOES, rng.randint(4, 6)))
        elif family == "trominoes":
            names = _TROMINOES
        elif family == "small pieces":
            names = ("domino", *_TROMINOES, *rng.sample(("dot", "O", "S", "Z", "T"), rng.randint(1, 3)))
        elif family == "pentominoes":
            names = tuple(rng.sample(_PENTOMINOES, rng.randint(5, 8)))
        else:
            names = (
                *rng.sample(("domino", *_TROMINOES), rng.randint(0, 2)),
                *rng.sample(_TETROMINOES, rng.randint(2, 4)),
                *rng.sample(_PENTOMINOES, rng.randint(1, 3)),
            )
        return cls(family, tuple(tuple(_ART[name].split()) for name in names))

    @property
    def side(self) -> int:
        """The side of the largest box, in cells."""
        return max(map(len, self.art))

    @property
    def cells(self) -> float:
        """The mean number of cells per piece."""
        return sum("".join(piece).count("#") for piece in self.art) / len(self.art)

    def write(self, code: SourceBuilder) -> None:
        code.add("story", f"The pieces are {_words(self)}.")
        rows = [", ".join(f'"{row}"' for row in piece) for piece in self.art]
        code.add("pieces", *(f"({row}{',' if ',' not in row else ''})," for row in rows))
        code.add(
            "methods",
            """
            def _cells(self) -> list[tuple[int, int]]:
                \"\"\"Where the falling piece is, as (row, column); rows above the board are negative.\"\"\"
                return [<<cell>> for down, across in TURNS[self.kind][self.turn]]
            """,
        )


def _words(pieces: Pieces) -> str:
    if pieces.family == "tetrominoes":
        return "the seven tetrominoes"
    if pieces.family == "trominoes":
        return "the two trominoes, straight and bent"
    sizes = sorted({"".join(piece).count("#") for piece in pieces.art})
    cells = f"{sizes[0]} cells" if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]} cells"
    count = len(pieces.art)
    if pieces.family == "some tetrominoes":
        return f"{count} of the seven tetrominoes"
    return f"{count} {pieces.family} of {cells}"


def _custom(rng: Random, count: int) -> tuple[Piece, ...]:
    """Draw distinct polyominoes, up to rotation, of three to five cells in boxes of at most four by four."""
    found: dict[frozenset[tuple[int, int]], Piece] = {}
    while len(found) < count:
        cells = {(0, 0)}
        size = rng.randint(3, 5)
        while len(cells) < size:
            y, x = rng.choice(sorted(cells))
            down, across = rng.choice(((0, 1), (1, 0), (0, -1), (-1, 0)))
            cells.add((y + down, x + across))
        top, left = min(y for y, _ in cells), min(x for _, x in cells)
        here = {(y - top, x - left) for y, x in cells}
        side = 1 + max(max(cell) for cell in here)
        if side <= 4 and not any(turned in found for turned in _quarter_turns(here)):
            found[frozenset(here)] = tuple(
                "".join("#" if (y, x) in here else "." for x in range(side)) for y in range(side)
            )
    return tuple(found.values())


def _quarter_turns(cells: set[tuple[int, int]]) -> list[frozenset[tuple[int, int]]]:
    turned = []
    for _ in range(4):
        height = 1 + max(y for y, _ in cells)
        cells = {(x, height - 1 - y) for y, x in cells}
        turned.append(frozenset(cells))
    return turned
