"""Lander: bring a spaceship down on its pad, softly, before the fuel is gone.

Goal: touch the flat pad with both legs while both speed lamps in the bar at the top are green (the left lamp is the
sideways speed, the right one the speed of descent). Anything else that touches the ground is a crash. A side wind, as
strong as the flag on the pad shows, blows for the whole flight. Without fuel there is only falling.

Controls: the first button fires the main engine, and the second button, held with it, doubles its thrust for three
times the fuel. Left and right fire the side jets. Up and down are unused.

Rewards: +0.05 for each pixel nearer to the pad and +1 for each pixel per step slower (as much is taken back for moving
away or gaining speed), -2 for a crash, and +4 for a landing with up to 2 more for the fuel that is left.

What there is to learn: the agent controls the speed but needs the position, so braking has to begin long before the
ground. Terrain, pad, wind and the way the ship comes in differ from seed to seed.
"""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
HUD = 7
MAX_STEPS = 1000
SHIP = 7
PAD_WIDTH = 20
GRAVITY = 0.02
MAIN_THRUST = 0.045
SIDE_THRUST = 0.025
SAFE_SIDEWAYS, SAFE_DESCENT = 0.5, 0.8
FUEL = 200.0

SPACE, NIGHT, STAR, FAR, MOON, ROCK, DUST, PAD, LAMP, HULL, GLASS, LEG, FLAME, SPARK, GREEN, RED, SLOT = range(17)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex(
        "0e0e20 181632 d6d6e8 2c264a e8debe 5c4e68 968496 c8ccd6 ffde5c "
        "e2e6f0 5cb0e8 9498ac ff9438 ffe48c 68d680 e84e54 363254"
    ),
    dtype=np.uint8,
).reshape(-1, 3)
LETTERS = {".": 0, "H": HULL, "G": GLASS, "L": LEG}
SHIP_ART = np.array(
    [
        [LETTERS[letter] for letter in row]
        for row in (
            "...H...",
            "..HHH..",
            "..HGH..",
            ".HHGHH.",
            ".HHHHH.",
            ".L.H.L.",
            "L.....L",
        )
    ],
    dtype=np.uint8,
)


class Lander(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """One ship, one pad, gravity and wind."""

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
        self.fuel = FUEL
        self.won = self.lost = False
        self.jets = (0, 0, 0)
        self._shape_terrain()
        self._enter_ship()
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, burn, boost = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, burn, boost)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {
            "is_success": self.won,
            "fuel": self.fuel,
            "vx": self.vx,
            "vy": self.vy,
            "distance": self._distance(),
            "steps": self.steps,
        }

    # -- the rules -------------------------------------------------------------------------------------------------

    def _shape_terrain(self) -> None:
        """Hills are a sum of three waves; the pad is cut flat into them. `ground[x]` is the first solid pixel row."""
        xs = np.arange(SIZE)
        ground = np.full(SIZE, 68.0)
        for waves, height in ((1, 5.0), (2.5, 4.0), (6, 2.0)):
            ground += height * np.sin(xs * waves * math.tau / SIZE + self.np_random.uniform(0, math.tau))
        self.ground = ground.clip(52, 79).astype(np.int64)
        self.pad = int(self.np_random.integers(4, SIZE - PAD_WIDTH - 4))
        self.ground[self.pad : self.pad + PAD_WIDTH] = self.ground[self.pad + PAD_WIDTH // 2]
        self.wind = float(self.np_random.uniform(-0.003, 0.003))

    def _enter_ship(self) -> None:
        # The ship comes in on the far side of the screen, so that a straight fall never ends on the pad.
        left = self.pad + PAD_WIDTH / 2 > SIZE / 2
        self.x = float(self.np_random.uniform(4, 16) if left else self.np_random.uniform(SIZE - 16, SIZE - 4) - SHIP)
        self.y = float(self.np_random.uniform(HUD + 2, HUD + 8))
        self.vx = float(self.np_random.uniform(0.0, 0.4) * (1 if left else -1))
        self.vy = 0.0

    def _distance(self) -> float:
        across = self.x + SHIP / 2 - self.pad - PAD_WIDTH / 2
        return math.hypot(across, self.y + SHIP - float(self.ground[self.pad]))

    def _merit(self) -> float:
        """How good the position is: near the pad, and slow. Rewards are differences of it, so detours earn nothing."""
        return -0.05 * self._distance() - math.hypot(self.vx, self.vy)

    def _advance(self, direction: int, burn: int, boost: int) -> float:
        before = self._merit()
        self._fire(direction, burn, boost)
        self._drift()
        reward = self._merit() - before
        columns = self.ground[round(self.x) : round(self.x) + SHIP]
        if self.y + SHIP < columns.min():
            return reward
        return reward + self._touch_down()

    def _fire(self, direction: int, burn: int, boost: int) -> None:
        main = burn * (1 + boost) if self.fuel > 0 else 0
        side = (direction == 4) - (direction == 3) if self.fuel > 0 else 0
        self.jets = (main, int(side == 1), int(side == -1))
        self.fuel = max(0.0, self.fuel - (0.0, 1.0, 3.0)[main] - 0.5 * abs(side))
        self.vx += SIDE_THRUST * side + self.wind
        self.vy += GRAVITY - MAIN_THRUST * main

    def _drift(self) -> None:
        self.x += self.vx
        self.y += self.vy
        if not 0 <= self.x <= SIZE - SHIP:
            self.x = min(max(self.x, 0.0), float(SIZE - SHIP))
            self.vx = 0.0
        if self.y < HUD:
            self.y, self.vy = float(HUD), 0.0

    def _touch_down(self) -> float:
        on_pad = self.pad <= round(self.x) and round(self.x) + SHIP <= self.pad + PAD_WIDTH
        if on_pad and abs(self.vx) <= SAFE_SIDEWAYS and self.vy <= SAFE_DESCENT:
            self.won = True
            return 4.0 + 2.0 * self.fuel / FUEL
        self.lost = True
        return -2.0

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), SPACE, dtype=np.uint8)
        rows, columns = np.indices((SIZE, SIZE))
        canvas[rows > 40 + 4 * ((rows + columns) % 2)] = NIGHT
        for x, y in self.np_random.integers((0, HUD), (SIZE, 60), size=(28, 2)).tolist():
            canvas[y, x] = STAR
        moon_x, moon_y = int(self.np_random.integers(12, 72)), int(self.np_random.integers(18, 30))
        canvas[(columns - moon_x) ** 2 + (rows - moon_y) ** 2 < 30] = MOON
        canvas[(columns - moon_x - 3) ** 2 + (rows - moon_y + 1) ** 2 < 26] = SPACE
        ridge = 58 + 6 * np.sin(np.arange(SIZE) / 9.0 + self.pad)
        canvas[rows >= ridge] = FAR
        canvas[rows >= self.ground] = ROCK
        canvas[rows == self.ground] = DUST
        top = int(self.ground[self.pad])
        canvas[top : top + 2, self.pad : self.pad + PAD_WIDTH] = PAD
        canvas[top, [self.pad, self.pad + PAD_WIDTH - 1]] = LAMP
        canvas[:HUD] = SPACE
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        self._draw_flag(canvas)
        self._draw_ship(canvas, round(self.x), round(self.y))
        length = math.ceil(50 * self.fuel / FUEL)
        canvas[2:5, 3:53] = SLOT
        canvas[2:5, 3 : 3 + length] = FLAME
        canvas[2:5, 66:71] = GREEN if abs(self.vx) <= SAFE_SIDEWAYS else RED
        canvas[2:5, 75:80] = GREEN if self.vy <= SAFE_DESCENT else RED
        return canvas

    def _draw_flag(self, canvas: NDArray[np.uint8]) -> None:
        x, top = self.pad + PAD_WIDTH - 1, int(self.ground[self.pad]) - 7
        canvas[top : top + 7, x] = LEG
        length = round(abs(self.wind) * 2000)
        flutter = self.steps // 4 % 2
        for i in range(1, length + 1):
            column = x + (i if self.wind > 0 else -i)
            if 0 <= column < SIZE:
                canvas[top + (i + flutter) % 2 : top + 2 + (i + flutter) % 2, column] = RED

    def _draw_ship(self, canvas: NDArray[np.uint8], x: int, y: int) -> None:
        y = min(y, SIZE - SHIP)
        area = canvas[y : y + SHIP, x : x + SHIP]
        np.copyto(area, SHIP_ART, where=SHIP_ART > 0)
        if self.lost:
            np.copyto(area, np.uint8(FLAME), where=SHIP_ART == HULL)
            return
        main, left_jet, right_jet = self.jets
        if main:
            length = 2 * main + self.steps % 2
            canvas[y + 6 : y + 6 + length, x + 2 : x + 5] = FLAME
            canvas[y + 6 : y + 5 + length, x + 3] = SPARK
        if left_jet:
            canvas[y + 4, max(x - 2, 0) : x + 1] = SPARK
        if right_jet:
            canvas[y + 4, x + 6 : x + 9] = SPARK
