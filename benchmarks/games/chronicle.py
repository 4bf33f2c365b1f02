"""Chronicle: a game with a large ``info`` that differs at every step.

A courier walks between towns on a map and earns a point for each parcel delivered to its town.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
CELL = 6
MAX_STEPS = 1000
DIARY = 12_000
MOVES = ((0, 0), (0, -1), (0, 1), (-1, 0), (1, 0))


class Chronicle(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        cells = self.np_random.permutation(14 * 12)[:9]
        self.towns = [(int(cell) % 14, int(cell) // 14 + 2) for cell in cells[:8]]
        self.place = (int(cells[8]) % 14, int(cells[8]) // 14 + 2)
        self.steps = self.delivered = 0
        self.wanted = int(self.np_random.integers(8))
        self.weather = [0.0] * 24
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        dx, dy = MOVES[int(action[0])]
        self.place = (min(max(self.place[0] + dx, 0), 13), min(max(self.place[1] + dy, 2), 13))
        self.steps += 1
        self.weather = [*self.weather[1:], float(self.np_random.random())]
        arrived = self.place == self.towns[self.wanted]
        if arrived:
            self.delivered += 1
            self.wanted = (self.wanted + 1 + int(self.np_random.integers(7))) % 8
        terminated = self.delivered >= 12
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), float(arrived), terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        frame = np.full((SIZE, SIZE, 3), (36, 70, 44), np.uint8)
        frame[:10] = (20, 20, 30)
        frame[2:8, 2 : 2 + 6 * self.delivered] = (240, 200, 80)
        frame[9, : SIZE * (MAX_STEPS - self.steps) // MAX_STEPS] = (120, 160, 220)
        for number, (x, y) in enumerate(self.towns):
            colour = (230, 90, 70) if number == self.wanted else (150, 140, 130)
            frame[y * CELL : y * CELL + CELL, x * CELL : x * CELL + CELL] = colour
        x, y = self.place
        frame[y * CELL + 1 : y * CELL + 5, x * CELL + 1 : x * CELL + 5] = (250, 250, 250)
        return frame

    def _info(self) -> dict[str, Any]:
        weather = {f"hour {self.steps + hour}": rain for hour, rain in enumerate(self.weather)}
        diary = self.np_random.bytes(DIARY).hex()
        return {"is_success": self.delivered >= 12, "delivered": self.delivered, "weather": weather, "diary": diary}
