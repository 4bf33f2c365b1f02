# expect: EC206
"""Snow Fox: find the three berries hidden in a winter wood before the wolf, who can smell you, finds you.

The fox steps in four directions. The first button leaps two cells, the second crouches: a crouching fox stays where
it is and the wolf loses the scent for that step. Footprints stay in the snow, and walking through old ones costs
0.01, because the wolf follows beaten tracks. A berry pays 1, the last one another 5, the wolf costs 3; night falls
after 400 steps.

Broken on purpose: the list of footprints is made in `__init__` and never emptied, so an episode begins in the tracks
of the ones before it, and the same seed gives other pictures and rewards the second time: EnvCraft reports EC206. To
fix it, make the list in `reset()`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELL = 6
BOARD = 14
MAX_STEPS = 400
BERRIES = 3
TREES = 24
MOVES = ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1))

SNOW = (236, 242, 248)
SHADE = (224, 232, 242)
PRINT = (176, 194, 214)
TREE = (40, 92, 74)
TREE_TOP = (70, 132, 100)
TRUNK = (96, 70, 52)
BERRY = (214, 40, 72)
FOX, FOX_TAIL = (240, 120, 40), (255, 246, 236)
WOLF, WOLF_EYE = (84, 88, 100), (255, 220, 60)


class SnowFox(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (BOARD * CELL, BOARD * CELL, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode
        self.footprints: list[tuple[int, int]] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        # Trees stand at odd coordinates only, so that they can never wall anything in.
        spots = self.np_random.permutation((BOARD // 2) ** 2)[:TREES]
        self.trees = {(int(spot) // 7 * 2 + 1, int(spot) % 7 * 2 + 1) for spot in spots}
        clearings = [
            (row, column) for row in range(BOARD) for column in range(BOARD) if (row, column) not in self.trees
        ]
        self.fox = (BOARD // 2, BOARD // 2 - 1 + int(self.np_random.integers(0, 2)))
        if self.fox in self.trees:
            self.fox = (BOARD // 2 - 1, self.fox[1])
        near = [cell for cell in clearings if 2 <= self._distance(cell) <= 4]
        far = [cell for cell in clearings if self._distance(cell) >= 11]
        self.berries = [near[index] for index in self.np_random.permutation(len(near))[:BERRIES]]
        self.wolf = far[self.np_random.integers(len(far))]
        self.steps = 0
        self.caught = False
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if self.berries and not self.caught:
            crouching = bool(action[2])
            if not crouching:
                for _ in range(2 if action[1] else 1):
                    reward += self._walk(int(action[0]))
            if self.berries:
                self._prowl(scent=0.0 if crouching else 0.1)
                reward -= 3.0 if self.caught else 0.0
        terminated = not self.berries or self.caught
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _open(self, cell: tuple[int, int]) -> bool:
        return 0 <= cell[0] < BOARD and 0 <= cell[1] < BOARD and cell not in self.trees

    def _distance(self, cell: tuple[int, int]) -> int:
        return abs(cell[0] - self.fox[0]) + abs(cell[1] - self.fox[1])

    def _walk(self, direction: int) -> float:
        target = (self.fox[0] + MOVES[direction][0], self.fox[1] + MOVES[direction][1])
        if direction == 0 or not self._open(target) or target == self.wolf:
            return 0.0
        reward = 0.0
        if self.fox not in self.footprints:
            self.footprints.append(self.fox)
        self.fox = target
        if target in self.footprints:
            reward -= 0.01
        if target in self.berries:
            self.berries.remove(target)
            reward += 1.0 if self.berries else 6.0
        return reward

    def _prowl(self, scent: float) -> None:
        if self.steps % 2 == 0:
            around = [(self.wolf[0] + down, self.wolf[1] + right) for down, right in MOVES]
            around = [cell for cell in around if self._open(cell)]
            if self.np_random.random() < scent:
                self.wolf = min(around, key=self._distance)
            else:
                self.wolf = around[self.np_random.integers(len(around))]
        self.caught = self.wolf == self.fox

    def _info(self) -> dict[str, Any]:
        return {"is_success": not self.berries, "berries_left": len(self.berries)}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = np.full((BOARD * CELL, BOARD * CELL, 3), SNOW, np.uint8)
        canvas[::CELL] = SHADE
        if self.footprints:
            rows, columns = np.array(self.footprints).T * CELL
            for paw, side in ((1, 1), (2, 1), (3, 4), (4, 4)):
                canvas[rows + paw, columns + side] = PRINT
        for row, column in self.trees:
            canvas[row * CELL : row * CELL + 4, column * CELL : column * CELL + 6] = TREE
            canvas[row * CELL : row * CELL + 2, column * CELL + 1 : column * CELL + 5] = TREE_TOP
            canvas[row * CELL + 4 : row * CELL + 6, column * CELL + 2 : column * CELL + 4] = TRUNK
        for row, column in self.berries:
            canvas[row * CELL + 2 : row * CELL + 5, column * CELL + 1 : column * CELL + 5] = BERRY
        top, left = self.wolf[0] * CELL, self.wolf[1] * CELL
        canvas[top : top + 6, left : left + 6] = WOLF
        canvas[top + 2, left + 1 : left + 5 : 3] = WOLF_EYE
        top, left = self.fox[0] * CELL, self.fox[1] * CELL
        canvas[top + 1 : top + 5, left : left + 6] = FOX
        canvas[top + 1 : top + 3, left : left + 2] = FOX_TAIL
        return canvas
