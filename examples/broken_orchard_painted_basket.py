# expect: EC403
"""Orchard: catch nine apples in your basket before twelve have hit the grass.

Left and right carry the basket along, the first button doubles the pace, and with the second you hold it steady: it
stays where it is, but the rim is wider for that step. Apples ripen one after another and fall at their own speeds. An
apple caught pays 1, one on the grass costs 0.5, and the ninth in the basket pays another 5.

Broken on purpose: the scenery is painted once, at reset, to save time, and the basket was painted into it, so the
picture always shows the basket where it began, although it moves: every policy sees the same pictures, and EnvCraft
reports EC403. To fix it, move the lines that paint the basket from `_paint_scenery()` to `_draw()`, after the copy.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
MAX_STEPS = 800
TO_CATCH, TO_MISS = 9, 12
BASKET_TOP, BASKET_WIDTH = 70, 20
APPLE = 5
RIPEN_EVERY = 14

SKY_TOP, SKY_BOTTOM = np.array((126, 190, 236)), np.array((222, 240, 250))
LEAVES = (70, 148, 76)
LEAF_SHADE = (52, 120, 62)
GRASS = (124, 188, 84)
BASKET_COLOUR, BASKET_RIM = (166, 112, 62), (206, 156, 98)
APPLE_COLOURS = ((214, 48, 49), (240, 150, 50), (150, 200, 60))
STALK = (90, 60, 40)
ROUND = np.array([[c == "#" for c in line] for line in (".###.", "#####", "#####", "#####", ".###.")])


class Orchard(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.caught = self.missed = 0
        self.basket = int(self.np_random.integers(0, SIZE - BASKET_WIDTH + 1))
        self.apples: list[tuple[int, int, int, int]] = []
        self.scenery = self._paint_scenery()
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if not self._over():
            steady = bool(action[2])
            if not steady:
                pace = 6 if action[1] else 3
                shift = {3: -pace, 4: pace}.get(int(action[0]), 0)
                self.basket = min(max(self.basket + shift, 0), SIZE - BASKET_WIDTH)
            reward = self._drop_apples(rim=3 if steady else 0)
        truncated = not self._over() and self.steps >= MAX_STEPS
        return self._draw(), reward, self._over(), truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _over(self) -> bool:
        return self.caught >= TO_CATCH or self.missed >= TO_MISS

    def _drop_apples(self, rim: int) -> float:
        if self.steps % RIPEN_EVERY == 1:
            left = int(self.np_random.integers(2, SIZE - APPLE - 2))
            speed = int(self.np_random.integers(1, 4))
            self.apples.append((12, left, speed, int(self.np_random.integers(len(APPLE_COLOURS)))))
        reward = 0.0
        hanging = []
        for top, left, speed, kind in self.apples:
            if top + speed + APPLE < BASKET_TOP + 2:
                hanging.append((top + speed, left, speed, kind))
            elif self.basket - rim <= left + APPLE // 2 < self.basket + BASKET_WIDTH + rim:
                self.caught += 1
                reward += 6.0 if self.caught == TO_CATCH else 1.0
            else:
                self.missed += 1
                reward -= 0.5
        self.apples = hanging
        return reward

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.caught >= TO_CATCH, "caught": self.caught, "missed": self.missed}

    def _paint_scenery(self) -> NDArray[np.uint8]:
        fade = np.linspace(0.0, 1.0, SIZE)[:, None, None]
        scenery = np.broadcast_to(SKY_TOP + (SKY_BOTTOM - SKY_TOP) * fade, (SIZE, SIZE, 3)).astype(np.uint8)
        scenery[:10] = LEAVES
        for left in self.np_random.integers(0, SIZE - 6, size=14):
            scenery[9:13, left : left + 6] = LEAVES
            scenery[3:6, left + 1 : left + 5] = LEAF_SHADE
        scenery[80:] = GRASS
        scenery[BASKET_TOP : BASKET_TOP + 10, self.basket : self.basket + BASKET_WIDTH] = BASKET_COLOUR
        scenery[BASKET_TOP + 3 : BASKET_TOP + 10 : 3, self.basket + 1 : self.basket + BASKET_WIDTH - 1] = BASKET_RIM
        scenery[BASKET_TOP : BASKET_TOP + 2, self.basket : self.basket + BASKET_WIDTH] = BASKET_RIM
        return scenery

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.scenery.copy()
        for top, left, _, kind in self.apples:
            canvas[top : top + APPLE, left : left + APPLE][ROUND] = APPLE_COLOURS[kind]
            canvas[top - 1 : top + 1, left + 2] = STALK
        return canvas
