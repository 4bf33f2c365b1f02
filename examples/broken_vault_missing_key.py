# expect: EC801
"""The Vault: find the two keys that lie about the museum and open the vault.

You walk through the halls; the first button walks two cells at once, the second is not used. Stepping on a key picks
it up, and a lamp over the vault turns green for it. Stepping into the vault with both keys wins and pays 10; a
step costs 0.01. The museum opens its doors again after 300 steps.

Broken on purpose: `range(1, KEYS)` lays out one key where the vault asks for two, so no play can win. EnvCraft's
search visits every picture that can be reached, finds no success among them, and reports EC801. To fix it, lay out a
key for each number in `range(KEYS)`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELL = 12
BOARD = 7
MAX_STEPS = 300
KEYS = 2
CORNERS = ((0, 0), (0, BOARD - 1), (BOARD - 1, 0), (BOARD - 1, BOARD - 1))
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))

FLOOR, FLOOR_DARK = (214, 200, 176), (202, 186, 160)
WALL, WALL_LIGHT = (92, 84, 108), (120, 110, 138)
KEY = (232, 176, 30)
VAULT, VAULT_DIAL = (84, 98, 112), (190, 200, 210)
RED, GREEN = (200, 60, 60), (70, 210, 100)
COAT, FACE = (44, 58, 110), (246, 206, 170)
LAMP = (255, 240, 130)
KEY_SHAPE = np.array(
    [[c == "#" for c in line] for line in (".##......", "#..#.....", "#..######", "#..#..#.#", ".##...#.#")]
)


class Vault(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (BOARD * CELL, BOARD * CELL, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.walls = np.zeros((BOARD, BOARD), bool)
        # Each pillar has one wall, to the east or south, that stays off the rim: so all halls are connected.
        for row in range(1, BOARD, 2):
            for column in range(1, BOARD, 2):
                self.walls[row, column] = True
                east = self.np_random.random() < 0.5
                wall = (row, column + 1) if east else (row + 1, column)
                if max(wall) < BOARD - 1:
                    self.walls[wall] = True
        # In a corner the vault blocks nobody's way.
        self.vault = CORNERS[self.np_random.integers(len(CORNERS))]
        self.walls[self.vault] = True
        halls = [(int(row), int(column)) for row, column in np.argwhere(~self.walls)]
        places = iter([halls[index] for index in self.np_random.permutation(len(halls))])
        self.player = next(places)
        self.keys = [next(places) for _ in range(1, KEYS)]
        self.scenery = self._paint_scenery()
        self.found = 0
        self.steps = 0
        self.won = False
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        if not self.won:
            for _ in range(2 if action[1] else 1):
                self._walk(int(action[0]))
        reward = 10.0 if self.won else -0.01
        truncated = not self.won and self.steps >= MAX_STEPS
        return self._draw(), reward, self.won, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _walk(self, direction: int) -> None:
        down, right = MOVES[direction]
        target = (self.player[0] + down, self.player[1] + right)
        if target == self.vault:
            self.won = self.won or self.found == KEYS
        if min(target) < 0 or max(target) >= BOARD or self.walls[target]:
            return
        self.player = target
        if target in self.keys:
            self.keys.remove(target)
            self.found += 1

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "keys": self.found}

    def _paint_scenery(self) -> NDArray[np.uint8]:
        scenery = np.full((BOARD * CELL, BOARD * CELL, 3), FLOOR, np.uint8)
        scenery[::CELL] = FLOOR_DARK
        scenery[:, ::CELL] = FLOOR_DARK
        for row, column in np.argwhere(self.walls):
            scenery[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL] = WALL
            scenery[row * CELL : row * CELL + 4, column * CELL : (column + 1) * CELL] = WALL_LIGHT
        return scenery

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.scenery.copy()
        for row, column in self.keys:
            canvas[row * CELL + 4 : row * CELL + 9, column * CELL + 2 : column * CELL + 11][KEY_SHAPE] = KEY
        row, column = self.vault
        vault = canvas[row * CELL : (row + 1) * CELL, column * CELL : (column + 1) * CELL]
        vault[:] = VAULT
        vault[5:10, 4:9] = VAULT_DIAL
        vault[7, 5:8] = VAULT
        for key in range(KEYS):
            vault[1:4, 1 + 4 * key : 3 + 4 * key] = GREEN if key < self.found else RED
        top, left = self.player[0] * CELL, self.player[1] * CELL
        canvas[top + 5 : top + 11, left + 3 : left + 9] = COAT
        canvas[top + 1 : top + 5, left + 4 : left + 8] = FACE
        canvas[top + 4 : top + 7, left + 9 : left + 11] = LAMP
        return canvas
