# expect: EC601
"""Lights Out: switch off all sixteen lamps of a four by four board.

The arrows move the frame, the first button presses the lamp inside it, which flips that lamp and its neighbours
above, below, left and right. The second button takes the last press back, once. No board starts with a row that one
press puts out, and there is always a solution. The solved board pays 10, a press costs 0.02, and there are 240 steps
to think.

Broken on purpose: the game ends as won when one row is dark, because `lights.any(axis=1).all()` asks whether every
row still has a light, and random pressing puts out some row in nearly every episode: EnvCraft reports EC601, since
nothing is left to learn. To fix it, a board is solved when `not self.lights.any()`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

BOARD = 4
CELL = 21
MAX_STEPS = 240
# The rows that no single press can put out, as binary numbers.
HARD_ROWS = (0b0101, 0b0110, 0b1001, 0b1010, 0b1011, 0b1101, 0b1111)
PLACES = np.array((8, 4, 2, 1))
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))

WALL = (34, 36, 52)
SOCKET = (50, 54, 76)
GLOW = np.array((255, 214, 96))
DARK = np.array((66, 72, 98))
FRAME = (120, 220, 255)
DISTANCE = np.hypot(*(np.indices((CELL, CELL)) - CELL // 2))
BULB = DISTANCE <= 7.5
SHINE = np.clip(1.15 - DISTANCE / 18, 0.0, 1.0)[:, :, None]


def _lamp(colour: NDArray[np.int64]) -> NDArray[np.uint8]:
    tile = np.full((CELL, CELL, 3), WALL, np.uint8)
    tile[2:-2, 2:-2] = SOCKET
    tile[BULB] = (colour * SHINE).astype(np.uint8)[BULB]
    return tile


LAMPS = np.stack([_lamp(DARK), _lamp(GLOW)])


class LightsOut(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (BOARD * CELL, BOARD * CELL, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.presses: list[tuple[int, int]] = []
        self.undo_left = True
        self.cursor = (int(self.np_random.integers(BOARD)), int(self.np_random.integers(BOARD)))
        self.lights = np.zeros((BOARD, BOARD), bool)
        # Scrambling by presses, never by single lamps, keeps the board solvable.
        while not np.isin(self.lights @ PLACES, HARD_ROWS).all():
            self._press((int(self.np_random.integers(BOARD)), int(self.np_random.integers(BOARD))))
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if not self._solved():
            down, right = MOVES[int(action[0])]
            row, column = self.cursor
            self.cursor = (min(max(row + down, 0), BOARD - 1), min(max(column + right, 0), BOARD - 1))
            if action[1]:
                self._press(self.cursor)
                self.presses.append(self.cursor)
                reward -= 0.02
            elif action[2] and self.undo_left and self.presses:
                self._press(self.presses.pop())
                self.undo_left = False
            if self._solved():
                reward += 10.0
        terminated = self._solved()
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _press(self, lamp: tuple[int, int]) -> None:
        for down, right in MOVES:
            row, column = lamp[0] + down, lamp[1] + right
            if 0 <= row < BOARD and 0 <= column < BOARD:
                self.lights[row, column] ^= True

    def _solved(self) -> bool:
        return not self.lights.any(axis=1).all()

    def _info(self) -> dict[str, Any]:
        return {"is_success": self._solved(), "lit": int(self.lights.sum()), "presses": len(self.presses)}

    def _draw(self) -> NDArray[np.uint8]:
        tiles = LAMPS[self.lights.astype(int)]
        canvas = np.ascontiguousarray(tiles.swapaxes(1, 2)).reshape(BOARD * CELL, BOARD * CELL, 3)
        top, left = self.cursor[0] * CELL, self.cursor[1] * CELL
        square = canvas[top : top + CELL, left : left + CELL]
        square[:2] = square[-2:] = FRAME
        square[:, :2] = square[:, -2:] = FRAME
        if not self.undo_left:
            square[2:5, 2:5] = FRAME
        return canvas
