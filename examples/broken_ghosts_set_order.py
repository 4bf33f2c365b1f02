# expect: EC203
"""Ghost Garden: gather forty lanterns from the paths of a haunted garden while three ghosts walk them too.

You move along the paths. The first button runs two cells at once; the second rings a bell that holds the ghosts still
for six steps, and may be rung three times. A lantern pays 0.1, all that are needed pay 10. A ghost that catches you
takes one of three candles, at a cost of 1, and sends you back to the gate. At dawn, after 500 steps, the garden
closes.

Broken on purpose: the names of the ghosts are in a set of strings, and the ghosts are placed in the order of that
set, which depends on how Python hashes strings, so the same seed gives another garden under another PYTHONHASHSEED:
EnvCraft reports EC203. To fix it, keep the names in a tuple, or go through `sorted(...)`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELL = 7
BOARD = 11
MARGIN = 3
MAX_STEPS = 500
LANTERNS_TO_WIN = 40
CANDLES, BELLS, SPELL = 3, 3, 6
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))
GATE = (BOARD - 1, BOARD // 2)

GHOSTS = frozenset({"amber", "coral", "mint", "violet", "azure"})
GHOST_COLOURS = {
    "amber": (255, 191, 71),
    "coral": (255, 111, 105),
    "mint": (136, 232, 174),
    "violet": (180, 140, 255),
    "azure": (92, 190, 255),
}
PATH = (26, 32, 44)
HEDGE = (46, 110, 66)
LANTERN = (240, 226, 160)
PLAYER = (255, 255, 255)
EYES = (20, 20, 30)
FROZEN = (150, 170, 190)
GHOST_SHAPE = np.array([[c == "#" for c in line] for line in (".###.", "#####", "#####", "#####", "#.#.#")])


class GhostGarden(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.hedges = np.zeros((BOARD, BOARD), bool)
        # Each post grows one branch, east or south, never to the rim: so no branch can close a path off.
        for row in range(1, BOARD, 2):
            for column in range(1, BOARD, 2):
                self.hedges[row, column] = True
                east = self.np_random.random() < 0.5
                branch = (row, column + 1) if east else (row + 1, column)
                if max(branch) < BOARD - 1:
                    self.hedges[branch] = True
        self.lanterns = ~self.hedges
        self.lanterns[GATE] = False
        self.player = GATE
        free = [(int(row), int(column)) for row, column in np.argwhere(~self.hedges[: BOARD // 2])]
        self.ghosts: dict[str, tuple[int, int]] = {}
        for name in GHOSTS:
            if len(self.ghosts) < 3:
                self.ghosts[name] = free[self.np_random.integers(len(free))]
        self.steps = self.gathered = self.spell = 0
        self.candles, self.bells = CANDLES, BELLS
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if self.candles > 0 and self.gathered < LANTERNS_TO_WIN:
            if action[2] and self.bells > 0 and self.spell == 0:
                self.bells -= 1
                self.spell = SPELL
            for _ in range(2 if action[1] else 1):
                reward += self._walk(int(action[0]))
            reward -= self._haunt()
        success = self.gathered >= LANTERNS_TO_WIN
        terminated = success or self.candles == 0
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _free(self, cell: tuple[int, int]) -> bool:
        return 0 <= cell[0] < BOARD and 0 <= cell[1] < BOARD and not self.hedges[cell]

    def _walk(self, direction: int) -> float:
        down, right = MOVES[direction]
        target = (self.player[0] + down, self.player[1] + right)
        if not self._free(target) or target in self.ghosts.values():
            return 0.0
        self.player = target
        if not self.lanterns[target]:
            return 0.0
        self.lanterns[target] = False
        self.gathered += 1
        return 10.1 if self.gathered == LANTERNS_TO_WIN else 0.1

    def _haunt(self) -> float:
        """Move the ghosts every other step, and return what a catch costs."""
        if self.spell > 0:
            self.spell -= 1
            return 0.0
        if self.steps % 2 == 0:
            for name, (row, column) in self.ghosts.items():
                exits = [(row + down, column + right) for down, right in MOVES[1:]]
                exits = [cell for cell in exits if self._free(cell)]
                if self.np_random.random() < 0.3:
                    self.ghosts[name] = min(exits, key=self._distance)
                else:
                    self.ghosts[name] = exits[self.np_random.integers(len(exits))]
        if self.player not in self.ghosts.values():
            return 0.0
        self.candles -= 1
        self.player = GATE
        self.spell = SPELL
        return 1.0

    def _distance(self, cell: tuple[int, int]) -> int:
        return abs(cell[0] - self.player[0]) + abs(cell[1] - self.player[1])

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.gathered >= LANTERNS_TO_WIN, "lanterns": self.gathered, "candles": self.candles}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = np.full((84, 84, 3), PATH, np.uint8)
        garden = canvas[MARGIN : MARGIN + BOARD * CELL, MARGIN : MARGIN + BOARD * CELL]
        garden[self.hedges.repeat(CELL, axis=0).repeat(CELL, axis=1)] = HEDGE
        garden[CELL // 2 :: CELL, CELL // 2 :: CELL][self.lanterns] = LANTERN
        for name, (row, column) in self.ghosts.items():
            square = garden[row * CELL + 1 : row * CELL + 6, column * CELL + 1 : column * CELL + 6]
            square[GHOST_SHAPE] = FROZEN if self.spell else GHOST_COLOURS[name]
            square[1, 1::2] = EYES
        top, left = self.player[0] * CELL, self.player[1] * CELL
        garden[top + 1 : top + 6, left + 2 : left + 5] = PLAYER
        garden[top + 2 : top + 5, left + 1 : left + 6] = PLAYER
        for candle in range(self.candles):
            canvas[81:83, 3 + 4 * candle : 5 + 4 * candle] = PLAYER
        for bell in range(self.bells):
            canvas[81:83, 79 - 4 * bell : 81 - 4 * bell] = LANTERN
        return canvas
