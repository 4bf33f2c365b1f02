# expect: EC204
"""Table Pong: beat the house to three points.

You guard the right side of the table. Up and down move the bat, the first button moves it at double speed, and with
the second held the ball leaves your bat faster. The house follows the ball, but it is slow and now and then looks
away. A point won pays 1, a point lost costs 1; a rally that lasts until step 1000 ends the match undecided.

Broken on purpose: each serve is drawn from Python's global `random` module, which `reset(seed=...)` does not seed, so
the same seed and the same actions give another match whenever other code has used that generator. EnvCraft reports
EC204. To fix it, draw from the environment's own generator: `self.np_random.integers(...)` and
`self.np_random.choice(...)`.
"""

import random
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
MAX_STEPS = 1000
POINTS_TO_WIN = 3
BAT_HEIGHT, BAT_WIDTH = 18, 3
HOUSE_X, PLAYER_X = 4, SIZE - 4 - BAT_WIDTH
BALL = 3
PAUSE = 8

TABLE = (24, 88, 72)
LINE = (92, 150, 130)
HOUSE_COLOUR = (240, 128, 96)
PLAYER_COLOUR = (250, 220, 110)
BALL_COLOUR = (255, 255, 255)


class TablePong(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
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
        self.points = [0, 0]
        self.house = float(self.np_random.integers(0, SIZE - BAT_HEIGHT))
        self.player = float(self.np_random.integers(0, SIZE - BAT_HEIGHT))
        self._serve()
        return self._draw(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        self.steps += 1
        reward = 0.0
        if max(self.points) < POINTS_TO_WIN:
            speed = 4.0 if action[1] else 2.0
            shift = {1: -speed, 2: speed}.get(int(action[0]), 0.0)
            self.player = min(max(self.player + shift, 0.0), float(SIZE - BAT_HEIGHT))
            self._move_house()
            if self.pause > 0:
                self.pause -= 1
            else:
                reward = self._move_ball(smash=bool(action[2]))
        terminated = max(self.points) >= POINTS_TO_WIN
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._draw(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return self._draw()

    def _serve(self) -> None:
        self.ball_x, self.ball_y = SIZE / 2, float(random.randint(10, SIZE - 14))
        self.speed_x, self.speed_y = random.choice((-2.0, 2.0)), random.choice((-1.5, -1.0, 1.0, 1.5))
        self.pause = PAUSE

    def _move_house(self) -> None:
        looking = self.np_random.random() < 0.6
        error = self.ball_y - (self.house + BAT_HEIGHT / 2)
        if looking and abs(error) > 3:
            self.house = min(max(self.house + 1.5 * np.sign(error), 0.0), float(SIZE - BAT_HEIGHT))

    def _move_ball(self, smash: bool) -> float:
        self.ball_x += self.speed_x
        self.ball_y += self.speed_y
        if not 0 <= self.ball_y <= SIZE - BALL:
            self.ball_y = min(max(self.ball_y, 0.0), float(SIZE - BALL))
            self.speed_y = -self.speed_y

        if self.speed_x < 0 and HOUSE_X <= self.ball_x <= HOUSE_X + BAT_WIDTH and self._hits(self.house):
            self.speed_x = 2.0
            self._deflect(self.house)
        if self.speed_x > 0 and PLAYER_X <= self.ball_x + BALL <= PLAYER_X + BAT_WIDTH and self._hits(self.player):
            self.speed_x = -3.0 if smash else -2.0
            self._deflect(self.player)

        if -BALL <= self.ball_x <= SIZE:
            return 0.0
        winner = 0 if self.ball_x > SIZE else 1
        self.points[winner] += 1
        self._serve()
        return 1.0 if winner == 1 else -1.0

    def _hits(self, bat: float) -> bool:
        return bat - BALL < self.ball_y < bat + BAT_HEIGHT

    def _deflect(self, bat: float) -> None:
        self.speed_y = (self.ball_y + BALL / 2 - bat - BAT_HEIGHT / 2) / 4

    def _info(self) -> dict[str, Any]:
        house, player = self.points
        return {"is_success": player >= POINTS_TO_WIN, "house": house, "player": player}

    def _draw(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE, 3), TABLE, np.uint8)
        canvas[::6, SIZE // 2 : SIZE // 2 + 2] = LINE
        canvas[1::6, SIZE // 2 : SIZE // 2 + 2] = LINE
        for point in range(self.points[0]):
            canvas[3:6, 36 - 5 * point : 39 - 5 * point] = HOUSE_COLOUR
        for point in range(self.points[1]):
            canvas[3:6, 46 + 5 * point : 49 + 5 * point] = PLAYER_COLOUR
        house, player = int(self.house), int(self.player)
        canvas[house : house + BAT_HEIGHT, HOUSE_X : HOUSE_X + BAT_WIDTH] = HOUSE_COLOUR
        canvas[player : player + BAT_HEIGHT, PLAYER_X : PLAYER_X + BAT_WIDTH] = PLAYER_COLOUR
        x, y = max(int(self.ball_x), 0), int(self.ball_y)
        canvas[y : y + BALL, x : x + BALL] = BALL_COLOUR
        return canvas
