# expect: EC701
"""Hummingbird: fly through the gaps in four hedges.

The first button beats the wings, which lifts the bird and takes a moment to repeat; the second spreads them for a
slow glide. Left and right shift the bird a little along the path. Touching a hedge or the ground ends the flight and
costs 1; the top of the sky is soft. A hedge behind you pays 1, the fourth another 5. The day ends at step 600.

Broken on purpose: gravity pulls from the first step on, and from where the bird starts it meets the ground after some
fifteen steps, long before the first hedge is in view, so doing nothing loses at once and most exploration dies before
it has seen the game: EnvCraft reports EC701. To fix it, let the bird hover until its first wing beat, or for 40
steps.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
MAX_STEPS = 600
HEDGES_TO_WIN = 4
GROUND = 76
GAP, SPACING, HEDGE_WIDTH = 38, 50, 9
GRAVITY, LIFT, GLIDE = 0.25, -1.5, 0.6
BEAT = 11
BIRD_HEIGHT, BIRD_WIDTH = 6, 8

DAWN, NOON = np.array((250, 214, 190)), np.array((150, 206, 238))
HILL = (150, 190, 160)
SOIL, TURF = (150, 110, 80), (110, 176, 90)
HEDGE, HEDGE_LIGHT, BLOSSOM = (52, 124, 72), (84, 160, 96), (250, 150, 180)
BODY, WING, BEAK, THROAT = (30, 150, 140), (200, 240, 236), (60, 60, 70), (220, 60, 100)


def _sky(phase: float) -> NDArray[np.uint8]:
    fade = np.linspace(1.0, 0.0, SIZE)[:, None, None]
    sky = np.broadcast_to(DAWN + (NOON - DAWN) * fade, (SIZE, SIZE, 3)).astype(np.uint8)
    columns = np.arange(SIZE)
    ridge = (62 + 6 * np.sin(columns / 9 + phase) + 3 * np.sin(columns / 4)).astype(int)
    sky[np.arange(SIZE)[:, None] >= ridge] = HILL
    sky[GROUND:] = SOIL
    sky[GROUND : GROUND + 2] = TURF
    return sky


class Hummingbird(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.sky = _sky(phase=self.np_random.uniform(0.0, 2 * np.pi))
        self.steps = 0
        self.passed = 0
        self.crashed = False
        self.x, self.y = 16, float(self.np_random.integers(36, 46))
        self.speed = 0.0
        self.rest = 0
        self.hedges = [(SIZE + 6 + SPACING * n, int(self.np_random.integers(4, 34))) for n in range(HEDGES_TO_WIN)]
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if not self._over():
            self._fly(action)
            reward = self._advance()
        truncated = not self._over() and self.steps >= MAX_STEPS
        return self._draw(), reward, self._over(), truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _over(self) -> bool:
        return self.crashed or self.passed >= HEDGES_TO_WIN

    def _fly(self, action: NDArray[np.int64]) -> None:
        self.x = min(max(self.x + {3: -1, 4: 1}.get(int(action[0]), 0), 10), 28)
        self.rest = max(self.rest - 1, 0)
        self.speed = min(self.speed + GRAVITY, 3.0)
        if action[1] and self.rest == 0:
            self.speed = LIFT
            self.rest = BEAT
        elif action[2]:
            self.speed = min(self.speed, GLIDE)
        self.y += self.speed
        if self.y < 0:
            self.y, self.speed = 0.0, 0.0
        self.crashed = self.y + BIRD_HEIGHT >= GROUND

    def _advance(self) -> float:
        """Move the hedges one pixel nearer, and return the reward for what became of it."""
        self.hedges = [(left - 1, gap) for left, gap in self.hedges]
        for left, gap in self.hedges:
            level = self.x < left + HEDGE_WIDTH and left < self.x + BIRD_WIDTH
            if level and not gap <= self.y <= gap + GAP - BIRD_HEIGHT:
                self.crashed = True
        if self.crashed:
            return -1.0
        passed = sum(left + HEDGE_WIDTH <= self.x for left, _ in self.hedges)
        if passed <= self.passed:
            return 0.0
        self.passed = passed
        return 6.0 if passed == HEDGES_TO_WIN else 1.0

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.passed >= HEDGES_TO_WIN, "passed": self.passed}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.sky.copy()
        for left, gap in self.hedges:
            near, far = max(left, 0), max(left + HEDGE_WIDTH, 0)
            for top, bottom in ((0, gap), (gap + GAP, GROUND)):
                canvas[top:bottom, near:far] = HEDGE
                canvas[top:bottom, near + 1 : max(far - 6, 0)] = HEDGE_LIGHT
            canvas[gap - 2 : gap, near:far:2] = BLOSSOM
            canvas[gap + GAP : gap + GAP + 2, near:far:2] = BLOSSOM
        top, left = int(self.y), self.x
        canvas[top + 1 : top + 6, left + 1 : left + 6] = BODY
        canvas[top + 4 : top + 6, left + 3 : left + 6] = THROAT
        canvas[top + 2, left + 6 : left + BIRD_WIDTH] = BEAK
        wing = top - 2 if self.rest > BEAT // 2 else top + 3
        canvas[max(wing, 0) : wing + 3, left + 1 : left + 4] = WING
        for hedge in range(self.passed):
            canvas[80:83, 3 + 6 * hedge : 7 + 6 * hedge] = BLOSSOM
        return canvas
