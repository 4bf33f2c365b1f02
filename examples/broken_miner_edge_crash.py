# expect: EC107
"""Deep Miner: dig for five gems before the battery is flat, and keep out of the lava.

The miner walks and digs through soil in four directions. Stone stops it: the first button drills the cell it faces,
and with the second button held too the drill reaches one cell further. Drilling never hurts a gem. A gem pays 1, the
fifth another 5; stepping into lava ends the shift at a cost of 2, and so does the battery, without a penalty, at step
300.

Broken on purpose: the long drill checks only the first cell ahead, so one cell away from the right or lower edge,
facing it with both buttons held, it reads beyond the board: `step()` raises an IndexError and EnvCraft reports EC107
with the actions that lead there. To fix it, test `_inside()` for each cell in the loop, not for the first one alone.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELL = 7
BOARD = 12
MAX_STEPS = 300
GEMS, GEMS_TO_WIN = 14, 5
TUNNEL, SOIL, STONE, GEM, LAVA = range(5)
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))

COLOURS = np.array([(38, 28, 30), (121, 85, 61), (128, 128, 138), (121, 85, 61), (226, 88, 34)], np.uint8)
SKY = (132, 190, 230)
GEM_COLOUR = (96, 232, 255)
MINER_COLOUR = (255, 214, 64)
LAMP_COLOUR = (255, 255, 240)
BATTERY_COLOUR = (70, 160, 70)
DIAMOND = np.abs(np.indices((CELL, CELL)) - CELL // 2).sum(axis=0) <= 2


class DeepMiner(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (BOARD * CELL, BOARD * CELL, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.cells = np.full((BOARD, BOARD), SOIL)
        self.cells[0] = TUNNEL
        deposits = self.np_random.permutation(np.arange(2 * BOARD, BOARD * BOARD))
        self.cells.flat[deposits[:GEMS]] = GEM
        self.cells.flat[deposits[GEMS : GEMS + 18]] = STONE
        self.cells.flat[deposits[GEMS + 18 : GEMS + 21]] = LAVA
        self.row, self.column = 0, int(self.np_random.integers(3, BOARD - 3))
        self.facing = 2
        self.steps = 0
        self.gems = 0
        self.burnt = False
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        direction, drill, far = int(action[0]), bool(action[1]), bool(action[2])
        reward = 0.0
        if not self.burnt:
            if direction:
                self.facing = direction
            if drill:
                self._drill(2 if far else 1)
            if direction:
                reward = self._walk()
        success = self.gems >= GEMS_TO_WIN
        terminated = success or self.burnt
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _inside(self, row: int, column: int) -> bool:
        return 0 <= row < BOARD and 0 <= column < BOARD

    def _drill(self, reach: int) -> None:
        down, right = MOVES[self.facing]
        if not self._inside(self.row + down, self.column + right):
            return
        for distance in range(1, reach + 1):
            # A negative index would wrap around to the far side of the mine.
            row, column = max(self.row + down * distance, 0), max(self.column + right * distance, 0)
            if self.cells[row, column] in (SOIL, STONE):
                self.cells[row, column] = TUNNEL

    def _walk(self) -> float:
        down, right = MOVES[self.facing]
        row, column = self.row + down, self.column + right
        if not self._inside(row, column) or self.cells[row, column] == STONE:
            return 0.0
        found = self.cells[row, column]
        self.row, self.column = row, column
        if found == LAVA:
            self.burnt = True
            return -2.0
        self.cells[row, column] = TUNNEL
        if found == GEM:
            self.gems += 1
            return 6.0 if self.gems == GEMS_TO_WIN else 1.0
        return 0.0

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.gems >= GEMS_TO_WIN, "gems": self.gems}

    def _draw(self) -> NDArray[np.uint8]:
        canvas: NDArray[np.uint8] = COLOURS[self.cells].repeat(CELL, axis=0).repeat(CELL, axis=1)
        canvas[:CELL] = SKY
        for row, column in np.argwhere(self.cells == GEM):
            canvas[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL][DIAMOND] = GEM_COLOUR
        battery = (MAX_STEPS - self.steps) * 40 // MAX_STEPS
        canvas[1:3, 2 : 2 + max(battery, 0)] = BATTERY_COLOUR
        for gem in range(self.gems):
            canvas[1:4, 79 - 5 * gem : 82 - 5 * gem] = GEM_COLOUR

        top, left = self.row * CELL, self.column * CELL
        canvas[top + 1 : top + 6, left + 1 : left + 6] = MINER_COLOUR
        down, right = MOVES[self.facing]
        lamp_top, lamp_left = top + 2 + 2 * down, left + 2 + 2 * right
        canvas[lamp_top : lamp_top + 3, lamp_left : lamp_left + 3] = LAMP_COLOUR
        return canvas
