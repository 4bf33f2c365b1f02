"""NewGame: fetch the key from one room and carry it to the door of the other, through a gap in the wall.

Actions: up, down, left, right.

Observations: where you, the key, the door and the gap are, and whether you have the key.

Rewards: -0.01 for each step, +0.5 for the key, +1 for the door, which wins.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE, WALL = 9, 4
MAX_STEPS = 200
MOVES = ((0, -1), (0, 1), (-1, 0), (1, 0))

FLOOR, BRICK, YOU, KEY, DOOR = (70, 70, 84), (30, 30, 36), (240, 240, 230), (250, 200, 60), (90, 180, 110)


class NewGame(gym.Env[dict[str, Any], np.int64]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        cell = spaces.Box(0, SIZE - 1, (2,), np.int64)
        # An agent sees only this, so it must contain everything that a good decision needs.
        self.observation_space = spaces.Dict(
            {"you": cell, "key": cell, "door": cell, "gap": cell, "has_key": spaces.Discrete(2)}
        )
        self.action_space = spaces.Discrete(len(MOVES))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        # This seeds self.np_random, the only source of randomness here, so a seed always gives the same game.
        super().reset(seed=seed)
        # Reset everything that an episode changes, so that nothing of the last episode remains.
        self.steps = 0
        self.has_key = self.won = False
        rows = [int(row) for row in self.np_random.integers(SIZE, size=4)]
        self.you, self.gap = (WALL + 1, rows[0]), (WALL, rows[1])
        self.key, self.door = (0, rows[2]), (SIZE - 1, rows[3])
        return self._look(), self._info()

    def step(self, action: np.int64) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        column, row = (min(max(at + by, 0), SIZE - 1) for at, by in zip(self.you, MOVES[int(action)], strict=True))
        if column != WALL or (column, row) == self.gap:
            self.you = (column, row)
        reward = -0.01
        if self.you == self.key and not self.has_key:
            self.has_key = True
            reward += 0.5
        if self.you == self.door and self.has_key:
            self.won = True
            reward += 1.0
        # Terminated is the game's own end, truncated the clock.
        return self._look(), reward, self.won, self.steps >= MAX_STEPS and not self.won, self._info()

    def render(self) -> NDArray[np.uint8]:
        room = np.full((SIZE, SIZE, 3), FLOOR, np.uint8)
        room[:, WALL] = BRICK
        room[self.gap[::-1]] = FLOOR
        room[self.door[::-1]] = DOOR
        if not self.has_key:
            room[self.key[::-1]] = KEY
        room[self.you[::-1]] = YOU
        return room.repeat(16, axis=0).repeat(16, axis=1)

    def _look(self) -> dict[str, Any]:
        # New arrays each time: an observation that is handed out must not change afterwards.
        cells = {"you": self.you, "key": self.key, "door": self.door, "gap": self.gap}
        return {**{name: np.array(cell) for name, cell in cells.items()}, "has_key": np.int64(self.has_key)}

    def _info(self) -> dict[str, Any]:
        # Under this contract nothing else tells whether an episode was won.
        return {"is_success": self.won}
