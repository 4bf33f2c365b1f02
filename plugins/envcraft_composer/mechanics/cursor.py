"""The avatar `cursor`: a pointer that glides over everything, and a figure that jumps to it."""

from __future__ import annotations

from envcraft_composer.mechanic import Mechanic, traits

GROUP = "avatar"

_ACT = """
dy, dx = MOVES[move]
y, x = self.pointer
self.pointer = (min(max(y + dy, 0), ROWS - 1), min(max(x + dx, 0), COLUMNS - 1))
if first and self.pointer not in self.walls:
    self.at = self.pointer
"""
_DRAW = """
top, left = self._pixel(self.pointer)
frame[top : top + CELL, [left, left + CELL - 1]] = PALETTE[4]
frame[[top, top + CELL - 1], left : left + CELL] = PALETTE[4]
"""
_MOVES = ((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (4, 0, 0), (0, 1, 0))

MECHANIC = Mechanic(
    "cursor",
    "",
    gives=traits("mover", "points"),
    needs=traits("walk"),
    # A pointer does not cross the edges of the world, and cars would run over a figure that cannot step aside.
    bars=traits("wrap", "traffic"),
    parts={"avatar": "self.pointer = self.at", "act": _ACT, "over": _DRAW},
    controls="The four moves move the pointer, over walls too. The first button brings the figure to the pointer.",
    actions=_MOVES,
    pace=1.2,
)
