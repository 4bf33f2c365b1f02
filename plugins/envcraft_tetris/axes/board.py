"""The board: its size, its walls, and whether its sides wrap around."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder
from envcraft_tetris.axes.pieces import Pieces

SHAPES = ("rectangle", "bowl", "pillar", "stairs", "ledges", "islands")
#: Shapes without walls at the sides, which can wrap around.
_WRAPPABLE = ("rectangle", "pillar", "islands")
_TEXTS = {
    "bowl": "The corners at the bottom are walled up.",
    "pillar": "A pillar stands on the floor.",
    "stairs": "The floor rises in stairs to one side.",
    "ledges": "A ledge juts out of either side.",
    "islands": "Single blocks hang in the air and stay there.",
}


@dataclass(frozen=True)
class Board:
    """The board. `walls` holds its rows if it is not a rectangle: "#" for a wall, "." for a free cell."""

    rows: int
    columns: int
    shape: str
    wrap: bool
    walls: tuple[str, ...] = ()

    @classmethod
    def draw(cls, rng: Random, pieces: Pieces) -> Board:
        least = 6 if pieces.cells < 4.4 else 7
        columns = rng.randint(least, least + 5)
        rows = rng.randint(max(11, columns, 3 * pieces.side - 1), 20)
        shape = rng.choices(SHAPES, (11, 2, 2, 2, 2, 2))[0]
        wrap = shape in _WRAPPABLE and rng.random() < 0.22
        return cls(rows, columns, shape, wrap, _walls(rng, rows, columns, shape))

    def write(self, code: SourceBuilder) -> None:
        code.add("story", f"The board has {self.rows} rows of {self.columns} cells.")
        code.add("constants", f"ROWS, COLUMNS = {self.rows}, {self.columns}")
        free = "self.board = [[EMPTY] * COLUMNS for _ in range(ROWS)]"
        if self.walls:
            code.add(
                "story", _TEXTS[self.shape], "Walls never move; a block that a clearing moves into one is crushed."
            )
            code.add("constants", "# Hashes are walls.", "SHAPE = (", *(f'    "{row}",' for row in self.walls), ")")
            free = 'self.board = [[WALL if mark == "#" else EMPTY for mark in row] for row in SHAPE]'
        code.add("board", free)
        self._write_fits(code)

    def _write_fits(self, code: SourceBuilder) -> None:
        if self.wrap:
            code.add("story", "Its sides are one: what leaves on the left comes in on the right.")
            code.add("cell", "(self.row + down, (self.column + across) % COLUMNS)")
            code.add("place", "self.turn, self.row, self.column = turn, row, column % COLUMNS")
            code.add(
                "methods",
                """
                def _fits(self, turn: int, row: int, column: int) -> bool:
                    for down, across in TURNS[self.kind][turn]:
                        y = row + down
                        if y >= ROWS or (y >= 0 and self.board[y][(column + across) % COLUMNS]):
                            return False
                    return True
                """,
            )
            return
        code.add("cell", "(self.row + down, self.column + across)")
        code.add("place", "self.turn, self.row, self.column = turn, row, column")
        code.add(
            "methods",
            """
            def _fits(self, turn: int, row: int, column: int) -> bool:
                for down, across in TURNS[self.kind][turn]:
                    y, x = row + down, column + across
                    if y >= ROWS or not 0 <= x < COLUMNS or (y >= 0 and self.board[y][x]):
                        return False
                return True
            """,
        )


def _walls(rng: Random, rows: int, columns: int, shape: str) -> tuple[str, ...]:
    """Draw walls at random. Every row keeps free cells, and the upper half has no walls."""
    if shape == "rectangle":
        return ()
    walls: set[tuple[int, int]] = set()
    most = max(1, (columns - 4) // 2)
    if shape == "bowl":
        depth = rng.randint(1, most)
        walls = {(rows - 1 - y, x) for y in range(depth) for x in range(depth - y)}
        walls |= {(y, columns - 1 - x) for y, x in walls} if columns - 2 * depth >= 4 else set()
    elif shape == "pillar":
        width = 1 if columns < 8 else rng.randint(1, 2)
        left = (columns - width) // 2 + rng.choice((-1, 0, 0, 1))
        walls = {(rows - 1 - y, left + x) for y in range(rng.randint(2, rows // 3)) for x in range(width)}
    elif shape == "stairs":
        depth = rng.randint(1, columns - 4)
        walls = {(rows - 1 - y, x) for y in range(depth) for x in range(depth - y)}
        if rng.random() < 0.5:
            walls = {(y, columns - 1 - x) for y, x in walls}
    elif shape == "ledges":
        reach = rng.randint(1, most)
        left, right = (rng.randint(2 * rows // 3, rows - 3) for _ in range(2))
        walls = {(left, x) for x in range(reach)} | {(right, columns - 1 - x) for x in range(reach)}
    else:
        places = [(y, x) for y in range(2 * rows // 3, rows - 1, 2) for x in range(columns)]
        walls = set(rng.sample(places, rng.randint(2, 4)))
    return tuple("".join("#" if (y, x) in walls else "." for x in range(columns)) for y in range(rows))
