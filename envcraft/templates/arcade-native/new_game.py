"""NewGame: catch five falling plums in a basket before three of them are lost.

Controls: left and right move the basket. The first button moves it three times as fast.

Rewards: +1 for a plum, -1 for one that is lost.

The picture has the size that suits the game, and the game ends when it is won or lost: EnvCraft's adapter resizes the
frames to 84x84 and ends an episode at step 1,000.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

HEIGHT, WIDTH = 96, 128
BASKET, PLUM = 32, 8
CATCH, LOSE = 5, 3
FALL, SPEED = 3, 3

SKY, GRASS, FRUIT, WOOD = (150, 196, 224), (92, 140, 74), (112, 44, 110), (120, 82, 44)


class NewGame(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        # Stay, up, down, left or right; and two buttons.
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        # This seeds self.np_random, the only source of randomness here, so a seed always gives the same game.
        super().reset(seed=seed)
        # Reset everything that an episode changes, so that nothing of the last episode remains.
        self.basket = (WIDTH - BASKET) // 2
        self.caught = self.lost = 0
        self._drop()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction = {3: -1, 4: 1}.get(int(action[0]), 0)
        self.basket += direction * SPEED * (3 if action[1] else 1)
        self.basket = min(max(self.basket, 0), WIDTH - BASKET)
        self.height += FALL
        reward = self._land() if self.height >= HEIGHT - 2 * PLUM else 0.0
        # Terminated is the game's own end. Truncated, the clock, is left to the adapter.
        terminated = self.caught == CATCH or self.lost == LOSE
        return self.render(), reward, terminated, False, self._info()

    def render(self) -> NDArray[np.uint8]:
        # A new array each time: a frame that is handed out must not change afterwards.
        frame = np.full((HEIGHT, WIDTH, 3), SKY, np.uint8)
        frame[HEIGHT - PLUM :] = GRASS
        frame[self.height : self.height + PLUM, self.plum : self.plum + PLUM] = FRUIT
        frame[HEIGHT - 2 * PLUM : HEIGHT - PLUM, self.basket : self.basket + BASKET] = WOOD
        # The score belongs in the picture: an agent sees nothing else.
        for number in range(self.caught):
            frame[2:6, 3 + 7 * number : 8 + 7 * number] = FRUIT
        for number in range(self.lost):
            frame[2:6, WIDTH - 8 - 7 * number : WIDTH - 3 - 7 * number] = 0
        return frame

    def _info(self) -> dict[str, Any]:
        # Training programs read here whether the episode was won.
        return {"is_success": self.caught == CATCH, "caught": self.caught}

    def _drop(self) -> None:
        self.height = 0
        self.plum = int(self.np_random.integers(WIDTH - PLUM + 1))

    def _land(self) -> float:
        caught = self.basket <= self.plum + PLUM / 2 <= self.basket + BASKET
        self.caught += caught
        self.lost += not caught
        self._drop()
        return 1.0 if caught else -1.0
