"""Blink: the trivial environment. One lamp; press the first button while it is lit, for one point.

A step does almost nothing, so the overhead of the sandbox dominates.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

MAX_STEPS = 1000


class Blink(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = self.score = 0
        self.lit = self.np_random.random(MAX_STEPS + 1) < 0.3
        return self.render(), {}

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        hit = bool(action[1]) and bool(self.lit[self.steps])
        self.score += hit
        self.steps += 1
        return self.render(), float(hit), False, self.steps >= MAX_STEPS, {}

    def render(self) -> NDArray[np.uint8]:
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[24:60, 24:60, 0] = 255 * self.lit[self.steps]
        frame[80, : self.score % 84, 1] = 255
        return frame
