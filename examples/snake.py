"""Snake: eat six apples in a garden of rocks, and never bite a wall, a rock or yourself.

Goal: the snake sleeps in the middle of the garden until the first direction is given. From then on it creeps one cell
every third step and grows by two segments for each apple. The sixth apple wins. The bar at the top counts the apples.

Controls: a direction turns the head (a turn straight back is ignored). The first button sprints, one cell every step.
The second button is unused.

Rewards: +1 for an apple, +4 more for the last one, -1 for a crash.

What there is to learn: a turn is an intention that takes effect later, the obstacle to plan around is one's own past
path, and the sprint trades time to think for speed. Rocks, apples and the place to start differ from seed to seed.
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
HUD = 7
CELL = 7
COLUMNS, ROWS = 12, 11
MAX_STEPS = 1000
PERIOD = 3
ROCKS = 6
APPLES = 6
GROWTH = 2

Cell = tuple[int, int]
MOVES: dict[int, Cell] = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
ASLEEP: Cell = (0, 0)

NIGHT, TURF, MOWN, STONE, SHINE, STRIPE, SCALE, BELLY, EYE, APPLE, GLOSS, LEAF, SLOT = range(13)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex("1b1826 344940 395044 6c6a78 9695a0 ce9834 f0c452 ffe28e faf8f0 d83e42 fa927e 8ac45c 3a364a"),
    dtype=np.uint8,
).reshape(-1, 3)


def pixel_art(*rows: str) -> NDArray[np.uint8]:
    """Read rows of hexadecimal palette indices; a dot (index 0) is transparent."""
    return np.array([[int(c, 16) for c in row.replace(".", "0")] for row in rows], dtype=np.uint8)


APPLE_ART = pixel_art(
    "...bb..",
    "...b...",
    ".99999.",
    ".9a999.",
    ".99999.",
    ".99999.",
    "..999..",
)
ROCK_ART = pixel_art(
    ".......",
    "..344..",
    ".33344.",
    ".333334",
    "3333333",
    "3333333",
    ".33333.",
)


def stamp(canvas: NDArray[np.uint8], art: NDArray[np.uint8], x: int, y: int) -> None:
    """Draw pixel art with its top left corner at (x, y)."""
    height, width = art.shape
    np.copyto(canvas[y : y + height, x : x + width], art, where=art > 0)


class Snake(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """The classic on a 12 by 11 garden."""

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
        self.eaten = 0
        self.won = self.lost = False
        self._place_snake()
        self._place_rocks()
        self._place_apple()
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, sprint, _ = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, sprint)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "score": self.eaten, "length": len(self.body), "steps": self.steps}

    # -- the garden ------------------------------------------------------------------------------------------------

    def _place_snake(self) -> None:
        column, row = (int(self.np_random.integers(low, high)) for low, high in ((4, 8), (3, 8)))
        facing = 1 if self.np_random.random() < 0.5 else -1
        self.body: list[Cell] = [(column - facing * i, row) for i in range(3)]
        self.heading = ASLEEP
        self.clock = 0
        self.growing = 0

    def _place_rocks(self) -> None:
        # Rocks that touch neither each other nor the wall leave a way around each, so no apple is out of reach.
        self.rocks: list[Cell] = []
        while len(self.rocks) < ROCKS:
            column, row = (int(self.np_random.integers(1, n - 1)) for n in (COLUMNS, ROWS))
            others = self.rocks + self.body
            if all(max(abs(column - c), abs(row - r)) > 1 for c, r in others):
                self.rocks.append((column, row))

    def _place_apple(self) -> None:
        taken = {*self.body, *self.rocks}
        free = [(c, r) for r in range(ROWS) for c in range(COLUMNS) if (c, r) not in taken]
        self.apple = free[int(self.np_random.integers(len(free)))]

    # -- the rules -------------------------------------------------------------------------------------------------

    def _advance(self, direction: int, sprint: int) -> float:
        self._steer(direction)
        if self.heading == ASLEEP:
            return 0.0
        self.clock += PERIOD if sprint else 1
        if self.clock < PERIOD:
            return 0.0
        self.clock = 0
        return self._creep()

    def _steer(self, direction: int) -> None:
        if direction in MOVES and self._ahead(MOVES[direction]) != self.body[1]:
            self.heading = MOVES[direction]

    def _ahead(self, heading: Cell) -> Cell:
        return self.body[0][0] + heading[0], self.body[0][1] + heading[1]

    def _creep(self) -> float:
        head = self._ahead(self.heading)
        if self.growing:
            self.growing -= 1
        else:
            self.body.pop()
        inside = 0 <= head[0] < COLUMNS and 0 <= head[1] < ROWS
        if not inside or head in self.body or head in self.rocks:
            self.lost = True
            return -1.0
        self.body.insert(0, head)
        return self._eat() if head == self.apple else 0.0

    def _eat(self) -> float:
        self.eaten += 1
        self.growing += GROWTH
        if self.eaten == APPLES:
            self.won = True
            return 5.0
        self._place_apple()
        return 1.0

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), NIGHT, dtype=np.uint8)
        rows, columns = np.indices((ROWS * CELL, COLUMNS * CELL)) // CELL
        canvas[HUD:] = np.where((rows + columns) % 2, TURF, MOWN)
        for column, row in self.rocks:
            stamp(canvas, ROCK_ART, column * CELL, HUD + row * CELL)
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        for i in range(APPLES):
            canvas[2:5, 3 + 6 * i : 7 + 6 * i] = APPLE if i < self.eaten else SLOT
        if not self.won:
            stamp(canvas, APPLE_ART, self.apple[0] * CELL, HUD + self.apple[1] * CELL)
        self._draw_snake(canvas)
        return canvas

    def _draw_snake(self, canvas: NDArray[np.uint8]) -> None:
        # Each joint is filled together with the gap to the one behind it, which makes a tube and not a row of beads.
        for i in range(len(self.body) - 1, 0, -1):
            (c0, r0), (c1, r1) = self.body[i - 1], self.body[i]
            left, right = min(c0, c1) * CELL, max(c0, c1) * CELL
            top, bottom = HUD + min(r0, r1) * CELL, HUD + max(r0, r1) * CELL
            canvas[top + 1 : bottom + 6, left + 1 : right + 6] = STRIPE if i % 2 else SCALE
        x, y = self.body[0][0] * CELL, HUD + self.body[0][1] * CELL
        canvas[y + 1 : y + 6, x + 1 : x + 6] = STONE if self.lost else BELLY
        dx, dy = self.heading
        for side in (-1, 1):
            column, row = x + 3 + dx + side * (1 if dy or self.heading == ASLEEP else 0), y + 3 + dy + side * abs(dx)
            canvas[row, column] = SCALE if self.heading == ASLEEP else NIGHT
