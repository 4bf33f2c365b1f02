"""NewGame: gather the three lamps of a dark field, and keep out of the way of the owls that patrol it.

Controls: a direction moves one cell. The first button runs, two cells a step. The second button is unused.

Rewards: +1 for a lamp, +2 more for the last one, -1 when an owl catches you.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

CELLS, PIXELS = 12, 7
LAMPS, OWLS = 3, 3
MAX_STEPS = 300
MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

FIELD, YOU, LAMP, OWL = (24, 28, 44), (240, 240, 230), (250, 200, 60), (200, 70, 80)


class NewGame(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        # Stay, up, down, left or right; and two buttons.
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        # This seeds self.np_random, the only source of randomness here, so a seed always gives the same game.
        super().reset(seed=seed)
        # Reset everything that an episode changes, so that nothing of the last episode remains.
        self.steps = 0
        self.won = self.lost = False
        self.you = (int(self.np_random.integers(CELLS)), CELLS - 1)
        columns = self.np_random.choice(CELLS, LAMPS, replace=False)
        # One lamp above each owl, so that the player has to pass every owl.
        self.lamps = {(int(column), 3 * row) for row, column in enumerate(columns)}
        self.owls = [(int(self.np_random.integers(CELLS)), 3 * row + 1) for row in range(OWLS)]
        self.flights = [int(self.np_random.choice([-1, 1])) for _ in range(OWLS)]
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = self._walk(MOVES.get(int(action[0]), (0, 0)), 1 + int(action[1]))
        if self.steps % 2 == 0:
            self._fly()
        self.won = not self.lamps
        self.lost = self.lost or (self.you in self.owls and not self.won)
        # `terminated` is the end of the game; `truncated` is the time limit, at most 1,000 steps.
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward + 2.0 * self.won - self.lost, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        # A new array each time: a frame that is handed out must not change afterwards.
        field = np.full((CELLS, CELLS, 3), FIELD, np.uint8)
        for cells, colour in ((self.lamps, LAMP), ([self.you], YOU), (self.owls, OWL)):
            for column, row in cells:
                field[row, column] = colour
        return field.repeat(PIXELS, axis=0).repeat(PIXELS, axis=1)

    def _info(self) -> dict[str, Any]:
        # Training programs read here whether the episode was won.
        return {"is_success": self.won, "lamps": LAMPS - len(self.lamps)}

    def _walk(self, direction: tuple[int, int], cells: int) -> float:
        found = 0
        for _ in range(cells):
            column, row = (min(max(at + by, 0), CELLS - 1) for at, by in zip(self.you, direction, strict=True))
            self.you = (column, row)
            found += self.you in self.lamps
            self.lamps.discard(self.you)
        return float(found)

    def _fly(self) -> None:
        for number, (column, row) in enumerate(self.owls):
            if not 0 <= column + self.flights[number] < CELLS:
                self.flights[number] *= -1
            self.owls[number] = (column + self.flights[number], row)
