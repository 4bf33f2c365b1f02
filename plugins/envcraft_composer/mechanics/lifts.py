"""The world `lifts`: ledges seen from the side, and platforms that move between them and carry what stands on them."""

from __future__ import annotations

from random import Random

from envcraft_composer.mechanic import Constants, Mechanic, traits
from envcraft_composer.worlds import EDGE, PLATFORMS, frame_of

GROUP = "world"

_BUILD = """
self.lifts = []
for y in range(ROWS - 1 - STOREY, 0, -STOREY):
    # A ledge at each side, and a lift: its row, first column and way, and the columns between which it goes.
    low, high = self.np_random.integers((1, COLUMNS - 2), (3, COLUMNS)).tolist()
    self.walls |= {(y, x) for x in range(COLUMNS) if not low <= x < high}
    first = int(self.np_random.integers(low + 1, high - WIDE))
    self.lifts.append([y, first, 3 + y % 2, (low + 1, high - 1 - WIDE)])
self.at = (ROWS - 1, int(self.np_random.integers(COLUMNS)))
self.taken = {self.at}
# While things are placed, a lift fills its whole way, so that they can lie above all of it.
self.boards = {(y, x) for y, _, _, (first, last) in self.lifts for x in range(first, last + WIDE)}
"""
_SHIFT = '''
    def _shift(self, place: tuple[int, int], move: int) -> tuple[int, int]:
        """The cell one step away, or the same cell in front of a wall or a lift."""
        after = (place[0] + MOVES[move][0], place[1] + MOVES[move][1])
        return place if after in self.walls or after in self.boards else after
'''
_BOARDS = """
self.boards = {(y, x + part) for y, x, *_ in self.lifts for part in range(WIDE)}
"""
_MOVE = """
for lift in self.lifts if self.clock % PACE == 0 else []:
    y, x, way, ends = lift
    if x == ends[way - 3]:
        way = lift[2] = BACK[way]
    after = x + MOVES[way][1]
    # A lift waits for an avatar in its way.
    if self.at[0] != y or not after <= self.at[1] < after + WIDE:
        lift[1] = after
        if self.at[0] == y - 1 and x <= self.at[1] < x + WIDE:
            self.at = self._shift(self.at, way)
"""
_DRAW = """
for y, x, way, _ in self.lifts:
    for part in range(WIDE):
        self._blit(frame, (y, x + part), LIFT, PALETTE[2])
    top, left = self._pixel((y, x + (way - 3) * (WIDE - 1)))
    frame[top + CELL // 2, left + CELL // 2] = PALETTE[4]
"""


def _draw(rng: Random, level: float) -> Constants:
    rows, columns = rng.randint(11, 13), rng.randint(11, 13)
    return {**frame_of(rows, columns), "STOREY": 3, "WIDE": rng.randint(2, 3), "PACE": rng.randint(2, 3)}


MECHANIC = Mechanic(
    "lifts",
    "Ledges seen from the side. Lifts carry the avatar between them; a dot shows their way. What has no ground falls.",
    gives=traits("cells", "side"),
    parts={
        **PLATFORMS.parts,
        "build": EDGE + _BUILD,
        "touch": _BOARDS,
        "stir": _MOVE + _BOARDS.strip(),
        "method:shift": _SHIFT,
        "draw": _DRAW,
    },
    sprites=("LIFT",),
    shapes={
        "LIFT": (
            "11111 11111 00000 00000 00000",
            "11111 11111 01010 00000 00000",
            "11111 10101 11111 00000 00000",
        )
    },
    draw=_draw,
    pace=2.0,
)
