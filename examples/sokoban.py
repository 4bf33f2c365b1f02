"""Sokoban: push every crate onto a mark, and think before pushing.

Goal: all crates on the marks in the floor. A crate can be pushed but never pulled, one at a time, so a crate in a
corner stays there. Levels are made backwards, by pulling crates away from their marks, so they can always be solved.
The game takes 500 steps at most; the bar at the top shows crates in place and, in tenths, the time left.

Controls: a direction walks and pushes. The first button, pressed while standing still, takes back the last move: one
move for each press, however long it is held, and ten in a row. The second button is unused.

Rewards: +1 for a crate moved onto a mark, -1 for a crate moved off one, +4 for the last crate.

What there is to learn: planning with moves that cannot be undone by walking, where the reward for the nearest crate may
block the way for the next one.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
CELL = 12
COLUMNS, ROWS = 7, 6
TOP = 12
MAX_STEPS = 500
CRATES = 2
PILLARS = 2
PULLS = 60
SMALLEST_DISTANCE = 2
UNDO_DEPTH = 10

Cell = tuple[int, int]
MOVES: dict[int, Cell] = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

INK, FLOOR, GROUT, WALL, EDGE, MARK, WOOD, PLANK, NAIL, DONE, GLOW, SHIRT, SKIN, HAIR, SLOT = range(15)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex(
        "221e2a d6c8b2 c8b8a2 5e6882 7c88a4 d6605c ba8048 966236 623e28 70aa5c 4e8448 406eba f6cea6 543630 423c4e"
    ),
    dtype=np.uint8,
).reshape(-1, 3)


def pixel_art(*rows: str) -> NDArray[np.uint8]:
    """Read rows of hexadecimal palette indices; a dot (index 0) is transparent."""
    return np.array([[int(c, 16) for c in row.replace(".", "0")] for row in rows], dtype=np.uint8)


CRATE_ART = pixel_art(
    "888888888888",
    "866666666668",
    "867777777768",
    "867866666868",
    "867686668668",
    "867668686668",
    "867666866668",
    "867668686668",
    "867686668668",
    "867866666868",
    "866666666668",
    "888888888888",
)
STORED_ART = np.select([CRATE_ART == WOOD, CRATE_ART == PLANK], [np.uint8(DONE), np.uint8(GLOW)], CRATE_ART)
MARK_ART = pixel_art(
    *["............"] * 3,
    "...55..55...",
    "...555555...",
    "....5555....",
    "....5555....",
    "...555555...",
    "...55..55...",
    *["............"] * 3,
)
KEEPER_ART = pixel_art(
    "............",
    "....dddd....",
    "...dddddd...",
    "...dccccd...",
    "...cdccdc...",
    "...cccccc...",
    "....cccc....",
    "...bbbbbb...",
    "..bbbbbbbb..",
    "..cbbbbbbc..",
    "....dddd....",
    "....d..d....",
)


def stamp(canvas: NDArray[np.uint8], art: NDArray[np.uint8], x: int, y: int) -> None:
    """Draw pixel art with its top left corner at (x, y)."""
    height, width = art.shape
    np.copyto(canvas[y : y + height, x : x + width], art, where=art > 0)


class Sokoban(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """A warehouse, its keeper and two crates."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.won = False
        self.undo_held = False
        while not self._make_level():
            pass
        self.history: list[tuple[Cell, tuple[Cell, ...]]] = []
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, undo, _ = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won else self._advance(direction, bool(undo))
        truncated = self.steps >= MAX_STEPS and not self.won
        return self.render(), reward, self.won, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "score": self._stored(), "steps": self.steps}

    # -- the level -------------------------------------------------------------------------------------------------

    def _make_level(self) -> bool:
        """Play backwards from the solved position; refuse a level with a crate still beside a mark."""
        inner = [(x, y) for y in range(1, ROWS - 1) for x in range(1, COLUMNS - 1)]
        shuffled = [inner[i] for i in self.np_random.permutation(len(inner)).tolist()]
        self.floor = set(shuffled[PILLARS:])
        self.marks = shuffled[PILLARS : PILLARS + CRATES]
        self.crates: tuple[Cell, ...] = tuple(self.marks)
        self.keeper = shuffled[PILLARS + CRATES]
        for direction in self.np_random.integers(1, 5, size=4 * PULLS).tolist():
            self._pull(MOVES[direction])
        distances: list[int] = [abs(x - u) + abs(y - v) for x, y in self.crates for u, v in self.marks]
        return min(distances) >= SMALLEST_DISTANCE

    def _pull(self, move: Cell) -> None:
        (x, y), (dx, dy) = self.keeper, move
        target, behind = (x + dx, y + dy), (x - dx, y - dy)
        if target not in self.floor or target in self.crates:
            return
        self.crates = tuple(self.keeper if crate == behind else crate for crate in self.crates)
        self.keeper = target

    # -- the rules -------------------------------------------------------------------------------------------------

    def _stored(self) -> int:
        return sum(crate in self.marks for crate in self.crates)

    def _advance(self, direction: int, undo: bool) -> float:
        before = self._stored()
        if direction in MOVES:
            self._push(MOVES[direction])
        elif undo and not self.undo_held and self.history:
            self.keeper, self.crates = self.history.pop()
        self.undo_held = undo
        reward = float(self._stored() - before)
        if self._stored() == CRATES:
            self.won = True
            reward += 4.0
        return reward

    def _push(self, move: Cell) -> None:
        (x, y), (dx, dy) = self.keeper, move
        target, beyond = (x + dx, y + dy), (x + 2 * dx, y + 2 * dy)
        if target not in self.floor:
            return
        if target in self.crates and (beyond not in self.floor or beyond in self.crates):
            return
        self.history = [*self.history, (self.keeper, self.crates)][-UNDO_DEPTH:]
        self.crates = tuple(beyond if crate == target else crate for crate in self.crates)
        self.keeper = target

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), INK, dtype=np.uint8)
        for row in range(ROWS):
            for column in range(COLUMNS):
                x, y = column * CELL, TOP + row * CELL
                if (column, row) in self.floor:
                    canvas[y : y + CELL, x : x + CELL] = GROUT
                    canvas[y : y + CELL - 1, x : x + CELL - 1] = FLOOR
                else:
                    canvas[y : y + CELL, x : x + CELL] = WALL
                    canvas[y : y + 2, x : x + CELL] = EDGE
                    canvas[y + 6, x : x + CELL] = canvas[y + 2 : y + 6, x + 8] = canvas[y + 7 : y + CELL, x + 2] = EDGE
        for column, row in self.marks:
            stamp(canvas, MARK_ART, column * CELL, TOP + row * CELL)
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        for crate in self.crates:
            art = STORED_ART if crate in self.marks else CRATE_ART
            stamp(canvas, art, crate[0] * CELL, TOP + crate[1] * CELL)
        stamp(canvas, KEEPER_ART, self.keeper[0] * CELL, TOP + self.keeper[1] * CELL)
        for i in range(CRATES):
            canvas[3:9, 3 + 8 * i : 9 + 8 * i] = DONE if i < self._stored() else SLOT
        left = math.ceil(10 * (1 - self.steps / MAX_STEPS))
        for i in range(10):
            canvas[5:7, 32 + 5 * i : 36 + 5 * i] = MARK if i < left else SLOT
        return canvas
