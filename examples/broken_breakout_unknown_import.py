# expect: EC002
"""Brick Breaker: keep the ball in play with your paddle and break ten bricks before three balls are lost.

Left and right move the paddle, the first button makes it sprint, the second serves the ball, which otherwise serves
itself after a while. The nearer to the paddle's end the ball lands, the flatter it leaves. A brick pays 1, a lost
ball costs 1, and the tenth brick brings the wall down for another 5.

Broken on purpose: `gym_helpers` is not a library, only a name that sounds like one, so the file cannot be imported
and EnvCraft reports EC002. To fix it, drop the import and write the helper here: filling a rectangle is one NumPy
slice, `canvas[top : top + height, left : left + width] = colour`.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gym_helpers import fill_rect
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
MAX_STEPS = 1000
BRICKS_TO_WIN = 10
ROWS, COLUMNS = 4, 7
BRICK_TOP, BRICK_HEIGHT, BRICK_WIDTH = 14, 5, 12
PADDLE_TOP, PADDLE_HEIGHT, PADDLE_WIDTH = 77, 3, 20
BALL = 3
SERVE_AFTER = 25

SKY = (18, 20, 38)
ROW_COLOURS = ((235, 94, 85), (244, 162, 89), (250, 210, 110), (112, 193, 179))
PADDLE_COLOUR = (206, 212, 230)
BALL_COLOUR = (255, 255, 255)


class BrickBreaker(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.render_mode = render_mode

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.balls = 3
        self.broken = 0
        self.waiting = SERVE_AFTER
        self.bricks = self.np_random.random((ROWS, COLUMNS)) < 0.85
        self.paddle = int(self.np_random.integers(0, SIZE - PADDLE_WIDTH + 1))
        self._place_ball()
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        speed = 5 if action[1] else 3
        shift = {3: -speed, 4: speed}.get(int(action[0]), 0)
        self.paddle = min(max(self.paddle + shift, 0), SIZE - PADDLE_WIDTH)

        reward = 0.0
        if self.waiting > 0:
            self.waiting = 0 if action[2] else self.waiting - 1
            self.ball_x = self.paddle + PADDLE_WIDTH // 2 - 1
        elif self.balls > 0 and self.broken < BRICKS_TO_WIN:
            reward = self._move_ball()

        success = self.broken >= BRICKS_TO_WIN
        terminated = success or self.balls == 0
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _place_ball(self) -> None:
        self.ball_x, self.ball_y = self.paddle + PADDLE_WIDTH // 2 - 1, PADDLE_TOP - BALL
        self.speed_x, self.speed_y = int(self.np_random.choice((-2, -1, 1, 2))), -2
        self.waiting = SERVE_AFTER

    def _move_ball(self) -> float:
        self.ball_x += self.speed_x
        self.ball_y += self.speed_y
        if not 0 <= self.ball_x <= SIZE - BALL:
            self.ball_x = min(max(self.ball_x, 0), SIZE - BALL)
            self.speed_x = -self.speed_x
        if self.ball_y <= 0:
            self.ball_y, self.speed_y = 0, 2

        offset = self.ball_x + 1 - self.paddle
        if self.speed_y > 0 and PADDLE_TOP - BALL <= self.ball_y < PADDLE_TOP and 0 <= offset < PADDLE_WIDTH:
            self.ball_y, self.speed_y = PADDLE_TOP - BALL, -2
            self.speed_x = (-2, -1, 1, 2)[offset * 4 // PADDLE_WIDTH]
        if self.ball_y > SIZE:
            self.balls -= 1
            if self.balls > 0:
                self._place_ball()
            return -1.0

        row = (self.ball_y + 1 - BRICK_TOP) // BRICK_HEIGHT
        column = (self.ball_x + 1) // BRICK_WIDTH
        if 0 <= row < ROWS and self.bricks[row, column]:
            self.bricks[row, column] = False
            self.speed_y = -self.speed_y
            self.broken += 1
            return 6.0 if self.broken == BRICKS_TO_WIN else 1.0
        return 0.0

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.broken >= BRICKS_TO_WIN, "bricks": self.broken, "balls": self.balls}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE, 3), SKY, np.uint8)
        for row, column in np.argwhere(self.bricks):
            top, left = BRICK_TOP + row * BRICK_HEIGHT, column * BRICK_WIDTH
            fill_rect(canvas, top, left, BRICK_HEIGHT - 1, BRICK_WIDTH - 1, ROW_COLOURS[row])
        for ball in range(self.balls):
            fill_rect(canvas, 4, 4 + 6 * ball, BALL, BALL, BALL_COLOUR)
        for brick in range(self.broken):
            fill_rect(canvas, 4, 78 - 5 * brick, 3, 3, ROW_COLOURS[2])
        fill_rect(canvas, PADDLE_TOP, self.paddle, PADDLE_HEIGHT, PADDLE_WIDTH, PADDLE_COLOUR)
        fill_rect(canvas, self.ball_y, self.ball_x, BALL, BALL, BALL_COLOUR)
        return canvas
