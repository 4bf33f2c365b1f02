# expect: EC301
"""Moon Invaders: shoot down three waves of saucers before they land or their bombs find you.

Left and right move the gun, the first button fires (one shot in the air at a time), the second raises a shield for as
long as it is held, but a shielded gun cannot move or fire. Saucers march sideways, sink a little at each wall, and
the one nearest above the gun drops the bombs. A hit pays 1, a lost life costs 1, and there is a small charge each
step for the height that the wave has lost. The third wave cleared pays 10; three lives lost or one saucer landed end
the game, and so does step 1000.

Broken on purpose: the charge divides by the number of saucers left, and at the moment a wave is cleared that is 0 /
0, which NumPy turns into a warning and a NaN reward: EnvCraft reports EC301, because one NaN ruins every return and
gradient that contains it. To fix it, charge nothing while no saucer is left.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
MAX_STEPS = 1000
WAVES = ((1, 2), (2, 3), (2, 4))
LIVES = 3
GROUND = 78
GUN_WIDTH = 9

NIGHT = (12, 10, 30)
STAR = (110, 110, 150)
MOON = (150, 146, 160)
GUN = (120, 220, 255)
SHIELD = (60, 110, 200)
SHOT = (255, 250, 200)
BOMB = (255, 96, 80)
WAVE_COLOURS = ((140, 230, 120), (240, 190, 80), (230, 110, 200))
SAUCER = np.array(
    [[c == "#" for c in line] for line in ("...###...", "..#####..", "#########", "##.#.#.##", ".#.....#.")]
)
SAUCER_HEIGHT, SAUCER_WIDTH = SAUCER.shape


class MoonInvaders(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.stars = self.np_random.integers(0, (GROUND, SIZE), size=(25, 2))
        self.gun = int(self.np_random.integers(10, SIZE - 20))
        self.lives = LIVES
        self.steps = 0
        self.wave = -1
        self.shot: tuple[int, int] | None = None
        self.won = self.landed = self.shielded = False
        self._next_wave()
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if not self._over():
            if len(self.saucers) == 0:
                self._next_wave()
            self.shielded = bool(action[2])
            if not self.shielded:
                self.gun = min(max(self.gun + {3: -3, 4: 3}.get(int(action[0]), 0), 0), SIZE - GUN_WIDTH)
                if action[1] and self.shot is None:
                    self.shot = (GROUND - 6, self.gun + GUN_WIDTH // 2)
            self._march()
            reward += self._fly_shot() - self._drop_bombs()
            sunk = (self.saucers[:, 0] - 10).sum() / len(self.saucers)
            reward -= 0.0005 * float(sunk)
        truncated = not self._over() and self.steps >= MAX_STEPS
        return self._draw(), reward, self._over(), truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _over(self) -> bool:
        return self.won or self.landed or self.lives == 0

    def _next_wave(self) -> None:
        self.wave += 1
        rows, columns = WAVES[self.wave]
        left = int(self.np_random.integers(2, SIZE - 14 * columns))
        self.saucers = np.array(
            [(10 + 9 * row, left + 14 * column) for row in range(rows) for column in range(columns)]
        )
        self.drift = int(self.np_random.choice((-1, 1)))
        self.bombs: list[tuple[int, int]] = []
        self.shot = None

    def _march(self) -> None:
        columns = self.saucers[:, 1]
        if columns.min() + self.drift < 0 or columns.max() + self.drift > SIZE - SAUCER_WIDTH:
            self.drift = -self.drift
            self.saucers[:, 0] += 3
        else:
            self.saucers[:, 1] += self.drift
        self.landed = bool(self.saucers[:, 0].max() + SAUCER_HEIGHT >= GROUND - 4)

    def _fly_shot(self) -> float:
        if self.shot is None:
            return 0.0
        row, column = self.shot[0] - 7, self.shot[1]
        self.shot = (row, column) if row > 0 else None
        below, right = row - self.saucers[:, 0], column - self.saucers[:, 1]
        hit = (below >= -6) & (below < SAUCER_HEIGHT) & (right >= -1) & (right <= SAUCER_WIDTH)
        if not hit.any():
            return 0.0
        self.saucers = np.delete(self.saucers, int(hit.argmax()), axis=0)
        self.shot = None
        self.won = len(self.saucers) == 0 and self.wave == len(WAVES) - 1
        return 11.0 if self.won else 1.0

    def _drop_bombs(self) -> float:
        """Move the bombs, release new ones, and return what those that strike the gun cost."""
        if len(self.saucers) > 0 and self.np_random.random() < 0.085:
            row, column = self.saucers[np.abs(self.saucers[:, 1] - self.gun).argmin()]
            self.bombs.append((int(row) + SAUCER_HEIGHT, int(column) + SAUCER_WIDTH // 2))
        fallen = [(row + 2, column) for row, column in self.bombs]
        self.bombs = [bomb for bomb in fallen if bomb[0] < GROUND - 3]
        struck = any(row >= GROUND - 3 and self.gun <= column < self.gun + GUN_WIDTH for row, column in fallen)
        if not struck or self.shielded or self.won:
            return 0.0
        self.lives -= 1
        return 1.0

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "wave": self.wave + 1, "lives": self.lives}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE, 3), NIGHT, np.uint8)
        canvas[self.stars[:, 0], self.stars[:, 1]] = STAR
        canvas[GROUND:] = MOON
        for row, column in self.saucers:
            canvas[row : row + SAUCER_HEIGHT, column : column + SAUCER_WIDTH][SAUCER] = WAVE_COLOURS[self.wave]
        for row, column in self.bombs:
            canvas[row : row + 3, column : column + 2] = BOMB
        if self.shot is not None:
            canvas[self.shot[0] : self.shot[0] + 4, self.shot[1]] = SHOT
        canvas[GROUND - 3 : GROUND, self.gun : self.gun + GUN_WIDTH] = GUN
        canvas[GROUND - 6 : GROUND - 3, self.gun + 3 : self.gun + 6] = GUN
        if self.shielded:
            canvas[GROUND - 8 : GROUND - 7, max(self.gun - 1, 0) : self.gun + GUN_WIDTH + 1] = SHIELD
        for life in range(self.lives):
            canvas[80:82, 3 + 6 * life : 7 + 6 * life] = GUN
        return canvas
