# expect: EC110
"""Floor Painter: paint more than half of the hall while a cleaning robot scrubs it behind you.

Every tile the painter rolls over turns to colour. The first button makes it roll two tiles at once, the second paints
the tile on either side as well, from a supply of twelve such strokes. The cleaner wanders about and scrubs tiles
white again; when the two meet, paint is spilt and the cleaner is sent to another corner, and the third spill ends the
job at a cost of 3. A new tile pays 0.1, the finished floor 10. The hall closes after 250 steps.

Broken on purpose: drawing goes into one canvas, and `reset()` and `step()` return that canvas itself, so a picture
that was returned earlier changes later: a replay buffer would hold the last frame many times. EnvCraft reports EC110.
To fix it, return `self.canvas.copy()`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELL = 7
BOARD = 12
MAX_STEPS = 250
TILES_TO_WIN = 80
STROKES = 12
SPILLS = 3
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
CORNERS = ((0, 0), (0, BOARD - 1), (BOARD - 1, 0), (BOARD - 1, BOARD - 1))

BARE = (236, 232, 222)
GROUT = (206, 200, 188)
PAINT = np.array([(86, 180, 211), (244, 143, 177), (129, 199, 132), (255, 183, 77)], np.uint8)
PAINTER = (40, 44, 84)
CLEANER = (120, 124, 130)
BRUSH = (250, 250, 250)


class FloorPainter(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (BOARD * CELL, BOARD * CELL, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode
        self.canvas = np.zeros((BOARD * CELL, BOARD * CELL, 3), np.uint8)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.spills = 0
        self.strokes = STROKES
        self.painted = np.zeros((BOARD, BOARD), bool)
        self.colour = PAINT[self.np_random.integers(len(PAINT))]
        low, high = BOARD // 2 - 2, BOARD // 2 + 2
        self.painter = (int(self.np_random.integers(low, high)), int(self.np_random.integers(low, high)))
        self.cleaner = CORNERS[self.np_random.integers(4)]
        self._paint(self.painter)
        for row in range(BOARD):
            for column in range(BOARD):
                self._draw_tile((row, column))
        return self.canvas, self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if not self._finished() and self.spills < SPILLS:
            before = int(self.painted.sum())
            self._roll(int(action[0]), 2 if action[1] else 1, bool(action[2]))
            reward = 0.1 * (int(self.painted.sum()) - before)
            if self._finished():
                reward += 10.0
            else:
                reward -= self._clean()
        terminated = self._finished() or self.spills >= SPILLS
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.canvas, reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self.canvas.copy()

    def _roll(self, direction: int, tiles: int, wide: bool) -> None:
        down, right = MOVES[direction]
        wide = wide and direction > 0 and self.strokes > 0
        if wide:
            self.strokes -= 1
        for _ in range(tiles):
            previous, (row, column) = self.painter, self.painter
            self.painter = (min(max(row + down, 0), BOARD - 1), min(max(column + right, 0), BOARD - 1))
            self._paint(self.painter)
            if wide:
                for side in (-1, 1):
                    self._paint((self.painter[0] + side * right, self.painter[1] + side * down))
            self._draw_tile(previous)
        self._draw_tile(self.painter)

    def _clean(self) -> float:
        """Move the cleaner, and return what its move costs the painter."""
        previous, (row, column) = self.cleaner, self.cleaner
        down, right = MOVES[self.np_random.integers(1, 5)]
        self.cleaner = (min(max(row + down, 0), BOARD - 1), min(max(column + right, 0), BOARD - 1))
        cost = 0.0
        if self.painter in (previous, self.cleaner):
            self.spills += 1
            self.cleaner = max(CORNERS, key=self._distance_to_painter)
            cost = 3.0 if self.spills >= SPILLS else 0.5
        self.painted[self.cleaner] = False
        self._draw_tile(previous)
        self._draw_tile(self.cleaner)
        return cost

    def _distance_to_painter(self, tile: tuple[int, int]) -> int:
        return abs(tile[0] - self.painter[0]) + abs(tile[1] - self.painter[1])

    def _paint(self, tile: tuple[int, int]) -> None:
        if 0 <= tile[0] < BOARD and 0 <= tile[1] < BOARD:
            self.painted[tile] = True
            self._draw_tile(tile)

    def _draw_tile(self, tile: tuple[int, int]) -> None:
        top, left = tile[0] * CELL, tile[1] * CELL
        square = self.canvas[top : top + CELL, left : left + CELL]
        square[:] = GROUT
        square[:-1, :-1] = self.colour if self.painted[tile] else BARE
        if tile == self.cleaner:
            square[1:5, 1:5] = CLEANER
            square[2:4, 2:4] = BRUSH
        if tile == self.painter:
            square[0:6, 0:6] = PAINTER
            square[1:3, 1:5] = self.colour

    def _finished(self) -> bool:
        return int(self.painted.sum()) >= TILES_TO_WIN

    def _info(self) -> dict[str, Any]:
        return {"is_success": self._finished(), "painted": int(self.painted.sum()), "spills": self.spills}
