"""The code that the games of all four families share. Variants fill the slots in double angle brackets."""

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

SIZE, MAX_STEPS = 84, 1000
<<constants>>

<<colours>>


<<functions>>


<<tiles>>


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
        self.steps = 0
        self.reward = 0.0
        self.won = self.lost = False
        <<reset>>
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, first, second = (int(part) for part in action)
        self.steps += 1
        self.reward = <<step_reward>>
        if not (self.won or self.lost):
            self._advance(direction, first, second)
            if self.won:
                self.reward += PRIZE
            elif self.lost:
                self.reward -= PENALTY
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), self.reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        <<draw>>
        return frame

    def get_state(self) -> dict[str, Any]:
        """The state of the game as plain data."""
        return {
            <<state>>
        }

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, <<info>>}

    # -- the rules -------------------------------------------------------------------------------------------------

    def _advance(self, direction: int, first: int, second: int) -> None:
        <<advance>>

    <<methods>>
'''
