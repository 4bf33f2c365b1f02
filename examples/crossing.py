"""Crossing: lead two frogs over a busy road and a river of drifting logs, each to a lily bay of its own.

Goal: from the bank at the bottom hop between the cars, rest on the green strip, then hop from log to log (which carry
the frog sideways, also off the screen) and into an empty bay at the top. The hedge between the bays cannot be entered.
Two frogs in two bays win. The bar at the top shows four frogs: two may be lost, and the third lost frog ends the game.

Controls: a direction hops one row, or seven pixels sideways. The first button makes the hop a leap twice as far, after
which the frog has to rest longer. The second button is unused.

Rewards: +0.1 for each row that this frog reaches for the first time, +1 for a bay, +3 for the second one, -0.5 for
a frog lost.

What there is to learn: timing. Every lane has a speed and a direction of its own that differ from seed to seed, and the
safe moment to hop depends on where the next two lanes will be, not on where they are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
ROW = 7
MAX_STEPS = 1000
HOME_ROW, RIVER, STRIP, ROAD, BANK = 1, range(2, 6), 6, range(7, 11), 11
BAYS_NEEDED = 2
FROGS = 4
FROGS_TO_LOSE = 3
HOP_REST, LEAP_REST = 3, 7
SPAN = 112
MARGIN = 28

MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

INK, WATER, RIPPLE, GRASS, BLADE, ASPHALT, LINE, LOG, BARK, FROG, EYE, HEDGE, LILY, RED, BLUE, CREAM = range(16)
# One hexadecimal red-green-blue triple for each name above.
PALETTE = np.frombuffer(
    bytes.fromhex(
        "181a24 3670b0 4e8ac6 68a85c 7ebc6a 424250 70707a 9c6c44 "
        "744c32 a8e84e 1c2c1e 2c6042 f096be de524a 5c80e6 f6eac8"
    ),
    dtype=np.uint8,
).reshape(-1, 3)


def pixel_art(*rows: str) -> NDArray[np.uint8]:
    """Read rows of hexadecimal palette indices; a dot (index 0) is transparent."""
    return np.array([[int(c, 16) for c in row.replace(".", "0")] for row in rows], dtype=np.uint8)


FROG_ART = pixel_art("9.....9", ".9a9a9.", ".99999.", "..999..", ".99999.", "9.999.9", "9.....9")
CAR_ART = pixel_art(".ee...ee..", "ddddddddd.", "dd66dd66df", "dd66dd66dd", "ddddddddd.", ".ee...ee..")
TRUCK_ART = pixel_art(
    ".aa.......aa..",
    "ffffffffff.ee.",
    "ffffffffffee6f",
    "ffffffffffee6e",
    "ffffffffff.ee.",
    ".aa.......aa..",
)


def stamp(canvas: NDArray[np.uint8], art: NDArray[np.uint8], x: int, y: int) -> None:
    """Draw pixel art with its left edge at x, which may lie outside, and its top at y."""
    skip = max(0, -x)
    part = art[:, skip : max(0, SIZE - x)]
    area = canvas[y : y + part.shape[0], x + skip : x + skip + part.shape[1]]
    np.copyto(area, part, where=part > 0)


class Lane(NamedTuple):
    """What moves along one row: all its pieces have one length and one speed."""

    row: int
    speed: float
    length: int
    starts: tuple[float, ...]
    art: NDArray[np.uint8]


class Crossing(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """Four lanes of traffic, four lanes of logs."""

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
        self.frogs_lost = 0
        self.won = self.lost = False
        self._lay_lanes()
        self._new_frog()
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, leap, _ = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, leap)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {"is_success": self.won, "score": sum(self.filled), "frogs_lost": self.frogs_lost, "steps": self.steps}

    # -- the lanes -------------------------------------------------------------------------------------------------

    def _lay_lanes(self) -> None:
        self.lanes: dict[int, Lane] = {}
        sign = 1 if self.np_random.random() < 0.5 else -1
        for row in (*RIVER, *ROAD):
            # Neighbouring lanes run against each other, which no single held direction gets through for long.
            sign = -sign
            speed = sign * float(self.np_random.uniform(0.3, 0.7) if row in RIVER else self.np_random.uniform(0.5, 1.1))
            art = self._log() if row in RIVER else self._car(sign)
            count = 3 if row in RIVER else 2
            first = float(self.np_random.uniform(0, SPAN))
            gaps = self.np_random.uniform(-5, 5, count).tolist()
            starts = tuple(first + i * SPAN / count + gap for i, gap in enumerate(gaps))
            self.lanes[row] = Lane(row, speed, art.shape[1], starts, art)
        self.bays = [int(13 + 19 * i + self.np_random.integers(-4, 5)) for i in range(4)]
        self.filled = [False] * len(self.bays)

    def _log(self) -> NDArray[np.uint8]:
        art = np.full((ROW - 2, int(self.np_random.integers(18, 26))), LOG, dtype=np.uint8)
        art[-1] = art[1::2, ::5] = art[:, -1] = BARK
        art[[0, 0, -1, -1], [0, -1, 0, -1]] = 0
        return art

    def _car(self, sign: int) -> NDArray[np.uint8]:
        art = TRUCK_ART if self.np_random.random() < 0.4 else CAR_ART
        return art if sign > 0 else art[:, ::-1]

    def _lefts(self, lane: Lane) -> list[float]:
        """Left edges now. Lanes are a function of time alone, and wrap around beyond the screen."""
        shift = lane.speed * self.steps
        return [(start + shift) % SPAN - MARGIN for start in lane.starts]

    # -- the rules -------------------------------------------------------------------------------------------------

    def _new_frog(self) -> None:
        self.x = float(self.np_random.integers(14, SIZE - 21))
        self.row = self.best_row = BANK
        self.rest = 0
        self.turns = 0

    def _advance(self, direction: int, leap: int) -> float:
        self.rest = max(0, self.rest - 1)
        if direction in MOVES and not self.rest:
            self._hop(direction, 1 + leap)
        bay = self._bay() if self.row == HOME_ROW else None
        if bay is not None:
            return self._come_home(bay)
        reward = self._progress()
        return reward if self._safe() else reward + self._lose_frog()

    def _hop(self, direction: int, length: int) -> None:
        dx, dy = MOVES[direction]
        self.turns = {1: 0, 2: 2, 3: 1, 4: 3}[direction]
        self.rest = LEAP_REST if length == 2 else HOP_REST
        self.x = min(max(self.x + dx * length * ROW, 0.0), float(SIZE - ROW))
        target = min(max(self.row + dy * length, HOME_ROW), BANK)
        if target > HOME_ROW or self._bay() is not None:
            self.row = target

    def _bay(self) -> int | None:
        centre = self.x + ROW / 2
        return next((i for i, bay in enumerate(self.bays) if abs(bay - centre) < 6 and not self.filled[i]), None)

    def _come_home(self, bay: int) -> float:
        self.filled[bay] = True
        reward = self._progress() + 1.0
        if sum(self.filled) == BAYS_NEEDED:
            self.won = True
            return reward + 3.0
        self._new_frog()
        return reward

    def _progress(self) -> float:
        gained = max(0, self.best_row - self.row)
        self.best_row -= gained
        return 0.1 * gained

    def _safe(self) -> bool:
        lane = self.lanes.get(self.row)
        if lane is None:
            return True
        if self.row in ROAD:
            return not any(left < self.x + 6 and self.x + 1 < left + lane.length for left in self._lefts(lane))
        centre = self.x + ROW / 2
        if not any(left <= centre <= left + lane.length for left in self._lefts(lane)):
            return False
        self.x += lane.speed
        return -3 <= self.x <= SIZE - 4

    def _lose_frog(self) -> float:
        self.frogs_lost += 1
        if self.frogs_lost == FROGS_TO_LOSE:
            self.lost = True
        else:
            self._new_frog()
        return -0.5

    # -- the picture -----------------------------------------------------------------------------------------------

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), INK, dtype=np.uint8)
        rows, columns = np.indices((SIZE, SIZE))
        lane = rows // ROW
        canvas[(lane >= RIVER.start) & (lane < RIVER.stop)] = WATER
        canvas[(lane >= ROAD.start) & (lane < ROAD.stop)] = ASPHALT
        canvas[(lane == STRIP) | (lane == BANK)] = GRASS
        canvas[((lane == STRIP) | (lane == BANK)) & ((3 * columns + 7 * rows) % 11 == 0)] = BLADE
        for row in ROAD[1:]:
            canvas[row * ROW, (columns[0] % 8) < 4] = LINE
        canvas[ROW : 2 * ROW] = HEDGE
        canvas[ROW : 2 * ROW : 2, ::3] = GRASS
        for bay in self.bays:
            canvas[ROW + 1 : 2 * ROW, bay - 6 : bay + 6] = WATER
            canvas[ROW + 3 : ROW + 6, bay - 2 : bay + 2] = LILY
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        for row in RIVER:
            drift = int(self.lanes[row].speed * self.steps)
            canvas[row * ROW + 3, drift % 12 :: 12] = RIPPLE
        for lane in self.lanes.values():
            for left in self._lefts(lane):
                stamp(canvas, lane.art, round(left), lane.row * ROW + 1)
        for bay, filled in zip(self.bays, self.filled, strict=True):
            if filled:
                stamp(canvas, FROG_ART, bay - 3, HOME_ROW * ROW)
        if not (self.won or self.lost):
            stamp(canvas, np.rot90(FROG_ART, self.turns), round(self.x), self.row * ROW)
        self._draw_hud(canvas)
        return canvas

    def _draw_hud(self, canvas: NDArray[np.uint8]) -> None:
        for i in range(BAYS_NEEDED):
            canvas[2:5, 3 + 6 * i : 7 + 6 * i] = LILY if i < sum(self.filled) else ASPHALT
        for i in range(FROGS):
            canvas[2:5, SIZE - 6 - 6 * i : SIZE - 3 - 6 * i] = FROG if i < FROGS - self.frogs_lost else ASPHALT
