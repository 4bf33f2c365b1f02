"""The code that all variants share. Axes fill the slots in double angle brackets."""

from __future__ import annotations

SKELETON = '''\
"""<<title>>

<<about>>
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
MAX_STEPS = 1000
<<constants>>

# The pieces as they enter<<entering>>.
PIECES = (
    <<pieces>>
)
<<tables>>
# What a cell can hold, and further colours; pieces have the numbers between.
<<names>> = <<numbers>>

<<colours>>


<<functions>>


TURNS = tuple(turns(piece) for piece in PIECES)
TILES = np.stack([tile(colour) for colour in PALETTE])
<<tiles>>
BOTTOM, RIGHT = TOP + CELL * ROWS, LEFT + CELL * COLUMNS
BACKDROP = np.full((SIZE, SIZE, 3), PALETTE[PAGE])
BACKDROP[TOP - 1 : BOTTOM + 1, LEFT - 1 : RIGHT + 1] = PALETTE[RIM]


class <<class>>(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """<<summary>>"""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = self.cleared = 0
        self.reward = 0.0
        <<flags>>
        <<board>>
        <<reset>>
        <<queue>>
        <<started>>
        self._enter()
        self._paint()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, first, second = (int(part) for part in action)
        self.steps += 1
        self.reward = 0.0
        if not <<over>>:
            self._advance(direction, first, second)
            <<settle>>
        terminated = <<ended>>
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), self.reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        frame = self.picture.copy()
        <<ghost>>
        piece = TILES[<<colour>>]
        for y, x in self._cells():
            if y >= 0:
                top, left = TOP + CELL * y, LEFT + CELL * x
                frame[top : top + CELL, left : left + CELL] = piece
        <<frame>>
        return frame

    def _info(self) -> dict[str, Any]:
        return {<<info>>}

    # -- the rules -------------------------------------------------------------------------------------------------

    def _advance(self, direction: int, first: int, second: int) -> None:
        <<press>>
        <<steer>>
        <<fall>>
        <<tick>>

    <<methods>>

    # -- the picture -----------------------------------------------------------------------------------------------

    def _paint(self) -> None:
        """Draw all but the falling piece, for frames to begin with."""
        picture = BACKDROP.copy()
        codes = np.array(self.board)
        <<codes>>
        blocks = TILES.take(codes, axis=0).swapaxes(1, 2)
        picture[TOP:BOTTOM, LEFT:RIGHT] = blocks.reshape(CELL * ROWS, CELL * COLUMNS, 3)
        <<paint>>
        self.picture = picture

    <<panel>>
'''
