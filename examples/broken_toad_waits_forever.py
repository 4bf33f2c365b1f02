# expect: EC501
"""Toad Crossing: bring your toad over two roads to the pond.

The toad hops in four directions and rests for two steps after a hop. The first button makes a hop two cells long,
right over whatever lies between, with twice the rest; the second is a loud croak that stops all traffic for six
steps, and there is breath for one in a game. A car costs one of three lives, and 1 point, and the toad starts again
from the kerb. The pond pays 10, a row nearer to it than ever before 0.2. The toad is tired after 150 hops, and the
game is over.

Broken on purpose: the limit counts hops, not steps, so a toad that just sits on the kerb is never tired and its
episode never ends: EnvCraft reports EC501 for the policy that stands still. To fix it, count every call of `step()`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELL = 12
BOARD = 7
MAX_HOPS = 150
LANES = (1, 2, 4, 5)
LIVES, CROAKS, HUSH = 3, 1, 6
REST = 2
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))

POND, POND_LIGHT = (64, 140, 190), (110, 180, 220)
VERGE, VERGE_DARK = (120, 178, 90), (98, 156, 74)
ROAD, LINE = (66, 68, 76), (150, 150, 140)
TOAD, TOAD_DARK, EYE = (70, 200, 80), (40, 140, 56), (250, 250, 240)
GLASS, WHEEL = (190, 226, 240), (24, 24, 28)
CAR_COLOURS = ((226, 74, 70), (240, 200, 70), (90, 130, 230), (230, 130, 200))


def _paint_scenery() -> NDArray[np.uint8]:
    scenery = np.full((BOARD * CELL, BOARD * CELL, 3), VERGE, np.uint8)
    scenery[:CELL] = POND
    scenery[3:CELL:5, 4::16] = POND_LIGHT
    for top in (3 * CELL, 6 * CELL):
        scenery[top + 2 : top + CELL : 4, 3::9] = VERGE_DARK
    for top in (CELL, 4 * CELL):
        scenery[top : top + 2 * CELL] = ROAD
        for left in range(2, BOARD * CELL, 12):
            scenery[top + CELL - 1 : top + CELL + 1, left : left + 6] = LINE
    return scenery


SCENERY = _paint_scenery()


class ToadCrossing(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (BOARD * CELL, BOARD * CELL, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.cars = np.zeros((BOARD, BOARD), bool)
        for lane in LANES:
            self.cars[lane, self.np_random.permutation(BOARD)[: self.np_random.integers(2, 5)]] = True
        self.headings = self.np_random.choice((-1, 1), size=BOARD)
        self.periods = self.np_random.integers(4, 8, size=BOARD)
        self.clock = 0
        self.hops = 0
        self.hush = 0
        self.croaks = CROAKS
        self.lives = LIVES
        self._start()
        self.best = self.row
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        reward = 0.0
        if self.row > 0 and self.lives > 0:
            if action[2] and self.croaks > 0 and self.hush == 0:
                self.croaks -= 1
                self.hush = HUSH
            if self.rest > 0:
                self.rest -= 1
            elif action[0]:
                self.hops += 1
                self._hop(int(action[0]), 2 if action[1] else 1)
            self._drive()
            if self.row < self.best:
                reward += 0.2 * (self.best - self.row)
                self.best = self.row
            if self.cars[self.row, self.column]:
                self.lives -= 1
                reward -= 1.0
                self._start()
            if self.row == 0:
                reward += 10.0
        terminated = self.row == 0 or self.lives == 0
        truncated = not terminated and self.hops >= MAX_HOPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _start(self) -> None:
        self.rest = 0
        self.row, self.column = BOARD - 1, int(self.np_random.integers(BOARD))

    def _hop(self, direction: int, cells: int) -> None:
        down, right = MOVES[direction]
        self.rest = REST * cells
        self.row = min(max(self.row + down * cells, 0), BOARD - 1)
        self.column = min(max(self.column + right * cells, 0), BOARD - 1)

    def _drive(self) -> None:
        if self.hush > 0:
            self.hush -= 1
            return
        self.clock += 1
        for lane in LANES:
            if self.clock % self.periods[lane] == 0:
                self.cars[lane] = np.roll(self.cars[lane], self.headings[lane])

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.row == 0, "lives": self.lives, "croaks": self.croaks}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = SCENERY.copy()
        for lane, column in np.argwhere(self.cars):
            car = canvas[lane * CELL : (lane + 1) * CELL, column * CELL : (column + 1) * CELL]
            car[2:10, 2:5] = car[2:10, 8:11] = WHEEL
            car[3:9, 1:11] = CAR_COLOURS[LANES.index(lane)]
            windscreen = 7 if self.headings[lane] > 0 else 3
            car[4:8, windscreen : windscreen + 2] = GLASS
        toad = canvas[self.row * CELL : (self.row + 1) * CELL, self.column * CELL : (self.column + 1) * CELL]
        toad[2:11, 1:4] = toad[2:11, 8:11] = TOAD_DARK
        toad[2:10, 3:9] = TOAD
        toad[2:4, 3:9:4] = toad[2:4, 4:9:4] = EYE
        for life in range(self.lives):
            canvas[81:83, 3 + 6 * life : 7 + 6 * life] = TOAD_DARK
        for croak in range(self.croaks):
            canvas[81:83, 77 - 6 * croak : 81 - 6 * croak] = EYE
        return canvas
