"""Breakout: keep the ball in play and break the wall until the quota of bricks is met.

Goal: the wall, another mirrored pattern for every seed, hangs under the ceiling. The ball bounces off walls, bricks and
the paddle; where it meets the paddle decides the angle at which it leaves. Break as many bricks as the quota in the
bar at the top asks for. Three balls are given; when the last falls past the paddle the game is lost.

Controls: left and right move the paddle. The first button serves the ball along the dotted line (it serves itself after
a while). The second button brakes: the paddle moves slowly, for a precise angle. Up and down are unused.

Rewards: +0.5 for a brick, -0.5 for a lost ball, +4 for the quota.

What there is to learn: to be where the ball will be and not where it is, and then to aim: a ball that finds its way
above the wall bounces there by itself and breaks many bricks for a single return.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
HUD = 8
WALL = 2
MAX_STEPS = 1000
BALLS = 3
QUOTA = 12
ROWS, COLUMNS = 4, 8
BRICK_WIDTH, BRICK_HEIGHT, BRICK_TOP = 10, 5, 17
PADDLE_WIDTH, PADDLE_Y = 14, 77
PADDLE_SPEED, BRAKED_SPEED = 3, 1
BALL = 2
BALL_SPEED = 2.3
SUBSTEPS = 3
STEEPEST = 1.8
SERVE_DELAY = 20

VOID, DUSK, FRAME, EDGE, STEEL, LIGHT, SLOT, GOLD, ROSE, CORAL, AMBER, TEAL = range(12)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex("12121e 1c1c2e 4a4e6e 6e7498 b2bcd6 ffffff 303048 ffd666 e0567c f0845c f4be5c 52baac"),
    dtype=np.uint8,
).reshape(-1, 3)
ROW_COLOURS = (ROSE, CORAL, AMBER, TEAL)


class Breakout(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """Paddle, ball and a wall with a quota."""

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
        self.broken = 0
        self.balls = BALLS
        self.won = self.lost = False
        self.paddle = int(self.np_random.integers(20, SIZE - 20 - PADDLE_WIDTH))
        self._build_wall()
        self._new_ball()
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, serve, brake = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, serve, brake)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "score": self.broken, "balls": self.balls, "steps": self.steps}

    # -- the rules -------------------------------------------------------------------------------------------------

    def _build_wall(self) -> None:
        # Mirrored halves look designed; a wall with too few bricks for the quota is drawn again.
        while True:
            half = self.np_random.random((ROWS, COLUMNS // 2)) < 0.7
            self.bricks = np.concatenate([half, half[:, ::-1]], axis=1)
            if self.bricks.sum() >= QUOTA + 6:
                return

    def _new_ball(self) -> None:
        self.serving = SERVE_DELAY
        self.vx = float(self.np_random.uniform(-1.0, 1.0))
        self.vy = -math.sqrt(BALL_SPEED**2 - self.vx**2)
        self._hold_ball()

    def _hold_ball(self) -> None:
        self.x, self.y = self.paddle + PADDLE_WIDTH / 2 - BALL / 2, float(PADDLE_Y - BALL)

    def _advance(self, direction: int, serve: int, brake: int) -> float:
        self._move_paddle(direction, brake)
        if not self.serving:
            return self._fly()
        self._hold_ball()
        self.serving = 0 if serve else self.serving - 1
        return 0.0

    def _move_paddle(self, direction: int, brake: int) -> None:
        speed = BRAKED_SPEED if brake else PADDLE_SPEED
        target = self.paddle + speed * ((direction == 4) - (direction == 3))
        self.paddle = min(max(target, WALL), SIZE - WALL - PADDLE_WIDTH)

    def _fly(self) -> float:
        before = self.broken
        for _ in range(SUBSTEPS):
            # One axis after the other tells which face of a brick was hit.
            self.x += self.vx / SUBSTEPS
            if not WALL <= self.x <= SIZE - WALL - BALL or self._break_brick():
                self.x -= self.vx / SUBSTEPS
                self.vx = -self.vx
            self.y += self.vy / SUBSTEPS
            if self.y < HUD + WALL or self._break_brick():
                self.y -= self.vy / SUBSTEPS
                self.vy = -self.vy
            self._meet_paddle()
        reward = 0.5 * (self.broken - before)
        if self.broken >= QUOTA:
            self.won = True
            return reward + 4.0
        return reward + (self._lose_ball() if self.y > SIZE else 0.0)

    def _break_brick(self) -> bool:
        row = int(self.y + BALL / 2 - BRICK_TOP) // BRICK_HEIGHT
        column = int(self.x + BALL / 2 - WALL) // BRICK_WIDTH
        if not (0 <= row < ROWS and 0 <= column < COLUMNS and self.bricks[row, column]):
            return False
        self.bricks[row, column] = False
        self.broken += 1
        return True

    def _meet_paddle(self) -> None:
        level = PADDLE_Y - BALL <= self.y <= PADDLE_Y + 1
        if self.vy > 0 and level and self.paddle - BALL < self.x < self.paddle + PADDLE_WIDTH:
            reach = (PADDLE_WIDTH + BALL) / 2
            offset = (self.x + BALL / 2 - self.paddle - PADDLE_WIDTH / 2) / reach
            self.vx = STEEPEST * offset
            self.vy = -math.sqrt(BALL_SPEED**2 - self.vx**2)
            self.y = float(PADDLE_Y - BALL)

    def _lose_ball(self) -> float:
        self.balls -= 1
        if self.balls:
            self._new_ball()
        else:
            self.lost = True
        return -0.5

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), VOID, dtype=np.uint8)
        rows, columns = np.indices((SIZE, SIZE))
        canvas[(rows + columns) % 8 == 0] = DUSK
        canvas[HUD : HUD + WALL] = canvas[HUD:, :WALL] = canvas[HUD:, -WALL:] = FRAME
        canvas[HUD] = canvas[HUD:, 0] = canvas[HUD:, -1] = EDGE
        canvas[:HUD] = VOID
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        self._draw_hud(canvas)
        for row, column in np.argwhere(self.bricks).tolist():
            top, left = BRICK_TOP + row * BRICK_HEIGHT, WALL + column * BRICK_WIDTH
            canvas[top : top + BRICK_HEIGHT - 1, left : left + BRICK_WIDTH - 1] = ROW_COLOURS[row]
        canvas[PADDLE_Y : PADDLE_Y + 3, self.paddle : self.paddle + PADDLE_WIDTH] = STEEL
        canvas[PADDLE_Y, self.paddle + 1 : self.paddle + PADDLE_WIDTH - 1] = LIGHT
        canvas[PADDLE_Y + 1 : PADDLE_Y + 3, self.paddle + 5 : self.paddle + PADDLE_WIDTH - 5] = ROSE
        x, y = round(self.x), round(self.y)
        if self.serving:
            for i in range(2, 7):
                canvas[round(y + 3 * i * self.vy / 2), round(x + 3 * i * self.vx / 2)] = GOLD
        canvas[y : y + BALL, x : x + BALL] = GOLD
        return canvas

    def _draw_hud(self, canvas: NDArray[np.uint8]) -> None:
        for i in range(QUOTA):
            canvas[2:6, 3 + 4 * i : 6 + 4 * i] = TEAL if i < self.broken else SLOT
        for i in range(BALLS):
            canvas[3:5, SIZE - 5 - 4 * i : SIZE - 3 - 4 * i] = GOLD if i < self.balls else SLOT
