"""Maze walk: the NumPy game, a maze seen from within, in which lamps are collected before the time is up.

Left and right turn, up and down walk, the first button runs. Each lamp gives one point, and all
twelve win. Every frame is ray-cast: walls with brick texture, a chequered floor and the lamps, in array operations.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
CELLS = 17
LAMPS = 12
MAX_STEPS = 1000
TURN, WALK, REACH = math.radians(9), 0.12, 0.45
FIELD = 0.66  # half the width of the picture plane at distance 1
DEPTHS = np.arange(1, 351) * 0.04
ROWS = np.arange(SIZE)[:, None]
PLANE = np.linspace(-1, 1, SIZE)


class MazeWalk(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
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
        self._dig()
        free = np.argwhere(~self.wall)
        chosen = self.np_random.choice(len(free), LAMPS + 1, replace=False)
        self.position = free[chosen[0]] + 0.5
        self.lamps = free[chosen[1:]] + 0.5
        self.angle = float(self.np_random.uniform(0, math.tau))
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        move, run, _ = (int(part) for part in action)
        self.steps += 1
        self.angle = (self.angle + TURN * ((move == 4) - (move == 3))) % math.tau
        self._walk(WALK * (1 + run) * ((move == 1) - (move == 2)))
        near = np.hypot(*(self.lamps - self.position).T) < REACH
        self.lamps = self.lamps[~near]
        terminated = not len(self.lamps)
        return self.render(), float(near.sum()), terminated, self.steps >= MAX_STEPS and not terminated, self._info()

    def render(self) -> NDArray[np.uint8]:
        ahead = np.array([math.cos(self.angle), math.sin(self.angle)])
        aside = np.array([-ahead[1], ahead[0]]) * FIELD
        rays = ahead[:, None] + aside[:, None] * PLANE
        depth, brick = self._cast(rays)
        frame = self._floor(rays)
        half = SIZE / 2 / depth
        height = (ROWS - SIZE / 2 + half) / (2 * half)
        shade = (150 / (1 + 0.35 * depth)) * (0.75 + 0.25 * ((height * 8 % 1 > 0.15) & (brick * 4 % 1 > 0.08)))
        wall = (height >= 0) & (height < 1)
        colour = np.stack([shade * 1.5, shade * 0.9, shade * 0.7], axis=-1).clip(0, 255).astype(np.uint8)
        np.copyto(frame, colour, where=wall[:, :, None])
        self._draw_lamps(frame, ahead, aside, depth)
        frame[1:3, 2 : 2 + 6 * (LAMPS - len(self.lamps))] = (255, 220, 90)
        return frame

    def _info(self) -> dict[str, Any]:
        return {"is_success": not len(self.lamps), "lamps": len(self.lamps), "steps": self.steps}

    def _dig(self) -> None:
        """A maze by depth-first digging, with some walls taken out again so that there are loops."""
        self.wall = np.ones((CELLS, CELLS), bool)
        stack = [(1, 1)]
        self.wall[1, 1] = False
        while stack:
            x, y = stack[-1]
            steps = [(2, 0), (-2, 0), (0, 2), (0, -2)]
            ways = [(dx, dy) for dx, dy in steps if 0 < x + dx < CELLS and 0 < y + dy < CELLS]
            ways = [(dx, dy) for dx, dy in ways if self.wall[x + dx, y + dy]]
            if not ways:
                stack.pop()
                continue
            dx, dy = ways[int(self.np_random.integers(len(ways)))]
            self.wall[x + dx // 2, y + dy // 2] = self.wall[x + dx, y + dy] = False
            stack.append((x + dx, y + dy))
        inner = self.wall[1:-1, 1:-1]
        inner[self.np_random.random(inner.shape) < 0.15] = False

    def _walk(self, distance: float) -> None:
        for axis, part in enumerate((math.cos(self.angle), math.sin(self.angle))):
            wanted = self.position.copy()
            wanted[axis] += distance * part
            feeler = wanted.copy()
            feeler[axis] += math.copysign(0.2, distance * part)
            if not self.wall[int(feeler[0]), int(feeler[1])]:
                self.position = wanted

    def _cast(self, rays: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """For each column the distance of the wall, and where along the wall it is hit (0 to 1)."""
        x = self.position[0] + rays[0][:, None] * DEPTHS
        y = self.position[1] + rays[1][:, None] * DEPTHS
        cells = self.wall[x.astype(np.intp).clip(0, CELLS - 1), y.astype(np.intp).clip(0, CELLS - 1)]
        first = cells.argmax(axis=1)
        depth = DEPTHS[first]
        along = np.take_along_axis(x + y, first[:, None], axis=1)[:, 0] % 1
        return depth, along

    def _floor(self, rays: NDArray[np.float64]) -> NDArray[np.uint8]:
        below = np.arange(1, SIZE // 2 + 1)[:, None]
        distance = SIZE / 2 / below
        x = self.position[0] + rays[0] * distance
        y = self.position[1] + rays[1] * distance
        tile = (np.floor(x * 2) + np.floor(y * 2)) % 2
        light = (60 + 60 * tile) / (1 + 0.25 * distance)
        frame = np.empty((SIZE, SIZE, 3), np.uint8)
        frame[: SIZE // 2] = (26, 28, 44)
        frame[SIZE // 2 :] = light[:, :, None] * np.array([0.8, 0.9, 1.0])
        return frame

    def _draw_lamps(
        self,
        frame: NDArray[np.uint8],
        ahead: NDArray[np.float64],
        aside: NDArray[np.float64],
        depth: NDArray[np.float64],
    ) -> None:
        offset = self.lamps - self.position
        far = offset @ ahead
        across = offset @ aside / FIELD**2
        for index in np.argsort(-far):
            if far[index] < 0.2:
                continue
            centre = SIZE / 2 * (1 + across[index] / far[index])
            radius = max(SIZE * 0.12 / far[index], 1.0)
            columns = np.arange(max(int(centre - radius), 0), min(int(centre + radius) + 1, SIZE))
            columns = columns[depth[columns] > far[index]]
            disc = (ROWS - SIZE / 2) ** 2 + (columns - centre) ** 2 < radius**2
            part = frame[:, columns]
            part[disc] = (255, 220, 90)
            frame[:, columns] = part
