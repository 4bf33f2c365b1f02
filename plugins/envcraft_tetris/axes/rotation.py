"""How pieces rotate."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random

from envcraft.environments.source_builder import SourceBuilder

SYSTEMS = ("square", "corner", "foot")
#: Offsets (rows, columns) to try. None goes up, since a piece that climbs could stay in the air for ever.
KICKS = {
    "none": (),
    "beside": ((0, -1), (0, 1)),
    "far": ((0, -1), (0, 1), (0, -2), (0, 2)),
    "below": ((0, 1), (0, -1), (1, 0), (1, 1), (1, -1)),
}
_TEXTS = {
    "none": "where there is no room they do not",
    "beside": "where there is no room, one column aside",
    "far": "where there is no room, up to two columns aside",
    "below": "where there is no room, a cell aside or below",
}


@dataclass(frozen=True)
class Rotation:
    """The rotation `system` and the set of `kicks`."""

    system: str
    kicks: str

    @classmethod
    def draw(cls, rng: Random) -> Rotation:
        return cls(rng.choices(SYSTEMS, (3, 1, 1))[0], rng.choice(tuple(KICKS)))

    def write(self, code: SourceBuilder) -> None:
        about = {
            "square": "inside their square",
            "corner": "about their top left corner",
            "foot": "about their bottom left corner",
        }[self.system]
        code.add("story", f"They turn {about}; {_TEXTS[self.kicks]}.")
        code.add("entering", "" if self.system == "square" else " (empty rows and columns count for nothing)")
        code.add(
            "functions",
            """
            def turns(piece: tuple[str, ...]) -> tuple[tuple[tuple[int, int], ...], ...]:
                \"\"\"The cells (row, column) of a piece in four positions, each a turn clockwise from the last.\"\"\"
                found = []
                for _ in range(4):
                    cells = [(y, x) for y, row in enumerate(piece) for x, mark in enumerate(row) if mark == "#"]
                    <<pivot>>
                    piece = tuple("".join(column) for column in zip(*piece[::-1], strict=True))
                return tuple(found)
            """,
        )
        if self.system == "square":
            code.add("pivot", "found.append(tuple(cells))")
        elif self.system == "corner":
            code.add("pivot", "top, left = min(y for y, _ in cells), min(x for _, x in cells)")
            code.add("pivot", "found.append(tuple((y - top, x - left) for y, x in cells))")
        else:
            code.add("pivot", "low, left = len(piece) - 1 - max(y for y, _ in cells), min(x for _, x in cells)")
            code.add("pivot", "found.append(tuple((y + low, x - left) for y, x in cells))")
        code.add(
            "methods",
            """
            def _move(self, turn: int, row: int, column: int) -> bool:
                \"\"\"Put the piece there if it fits, and say whether it does.\"\"\"
                if not self._fits(turn, row, column):
                    return False
                <<place>>
                <<moved>>
                return True
            """,
        )
        if self.kicks == "none":
            code.add(
                "methods",
                """
                def _rotate(self, quarters: int) -> None:
                    self._move((self.turn + quarters) % 4, self.row, self.column)
                """,
            )
            return
        code.add("constants", f"KICKS = {((0, 0), *KICKS[self.kicks])}")
        code.add(
            "methods",
            """
            def _rotate(self, quarters: int) -> None:
                turn = (self.turn + quarters) % 4
                for down, across in KICKS:
                    if self._move(turn, self.row + down, self.column + across):
                        return
            """,
        )
