"""Radio Station: a labyrinth that walls up the way that was used.

The sound engineer carries a signal from the antenna to the clean note and back, twice. Every cell that is entered gets
warmer; every fourteen steps the warmest free cell becomes a wall and the coldest wall opens. A thread pins a cell open.
Three bursts of static prefer warm cells. Now and then left and right trade places, and the border turns red.
"""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 6
COLS, ROWS = 14, 13
TOP = 6  # the strip above the board shows the counts
MAX_STEPS = 1000
LIVES = 3
TRIPS = 2
THREADS = 10
GROW_EVERY = 14
STATIC_COUNT = 3
STATIC_PACE = 3
WALK_PACE = 2  # a move takes two steps
SWAP_PERIOD = 140
SWAP_SPAN = 25
HEAT_PER_VISIT = 1.0

WALNUT = np.array([74, 46, 30], np.uint8)
WALNUT_EDGE = np.array([104, 68, 44], np.uint8)
FLOOR = np.array([30, 24, 22], float)
WARM = np.array([150, 70, 40], float)
DIAL_GREEN = (90, 230, 120)
TAPE_BROWN = (176, 128, 84)
SIGNAL_RED = (232, 48, 48)
NOTE_BLUE = (110, 190, 255)
ENGINEER = (250, 240, 210)
THREAD = (230, 210, 90)

DIRECTIONS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


def sprite(*rows: str) -> np.ndarray:
    return np.array([[c == "#" for c in row] for row in rows])


ENGINEER_ART = sprite("..##..", ".####.", "..##..", "######", ".####.", ".#..#.")
NOTE_ART = sprite("...##.", "...#.#", "...#..", ".###..", "####..", ".##...")
ANTENNA_ART = sprite("#.##.#", ".####.", "..##..", "..##..", ".####.", "######")
STATIC_ART = sprite("#..#.#", ".##.#.", "#.###.", ".###.#", ".#.##.", "#.#..#")


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode: str | None = "rgb_array") -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(low=0, high=255, shape=(84, 84, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ setup
    def reset(self, *, seed: int | None = None, options: dict | None = None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.legs_done = 0  # two legs make a trip
        self.won = self.lost = False
        self.threads_left = THREADS
        self.rest = 0
        self._carve()
        self.heat = np.zeros((ROWS, COLS))
        self.pinned = np.zeros((ROWS, COLS), bool)
        self.antenna = (1, int(self.np_random.choice([1, 5, 11])))
        self.note = (COLS - 3, int(self.np_random.choice([3, 7, 9])))
        for x, y in (self.antenna, self.note):
            self.wall[y, x] = False
        self.px, self.py = self.antenna
        self.touched = {self.antenna}
        self.bursts: list[list[int]] = []
        for _ in range(STATIC_COUNT):
            self._spawn_burst()
        return self.render(), self._info()

    def _carve(self) -> None:
        """A maze by random depth-first search on the odd cells, with some walls opened so that it has loops."""
        self.wall = np.ones((ROWS, COLS), bool)
        stack = [(1, 1)]
        self.wall[1, 1] = False
        while stack:
            x, y = stack[-1]
            steps = [(dx, dy) for dx, dy in DIRECTIONS.values()
                     if 0 < x + 2 * dx < COLS - 1 and 0 < y + 2 * dy < ROWS - 1 and self.wall[y + 2 * dy, x + 2 * dx]]
            if not steps:
                stack.pop()
                continue
            dx, dy = steps[int(self.np_random.integers(len(steps)))]
            self.wall[y + dy, x + dx] = self.wall[y + 2 * dy, x + 2 * dx] = False
            stack.append((x + 2 * dx, y + 2 * dy))
        opened = 0
        while opened < 34:
            x, y = int(self.np_random.integers(1, COLS - 1)), int(self.np_random.integers(1, ROWS - 1))
            if self.wall[y, x]:
                self.wall[y, x] = False
                opened += 1

    def _spawn_burst(self) -> None:
        free = [(x, y) for y in range(ROWS) for x in range(COLS)
                if not self.wall[y, x] and abs(x - self.px) + abs(y - self.py) > 7 and (x, y) != self.note]
        x, y = free[int(self.np_random.integers(len(free)))]
        self.bursts.append([x, y])

    # ------------------------------------------------------------------ rules
    @property
    def swapped(self) -> bool:
        """Whether left and right trade places at this step."""
        return self.steps >= SWAP_PERIOD and self.steps % SWAP_PERIOD < SWAP_SPAN

    @property
    def goal(self) -> tuple[int, int]:
        return self.note if self.legs_done % 2 == 0 else self.antenna

    def step(self, action):
        direction, pin = int(action[0]), int(action[1])
        reward = 0.0
        if not (self.won or self.lost):
            reward = self._play(direction, bool(pin))
            self.steps += 1
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def _play(self, direction: int, pin: bool) -> float:
        reward = -0.001
        if pin and self.threads_left > 0 and not self.pinned[self.py, self.px]:
            self.pinned[self.py, self.px] = True
            self.threads_left -= 1
        self.rest = max(0, self.rest - 1)
        if direction and not self.rest:
            reward += self._walk(direction)
        if self.steps % STATIC_PACE == STATIC_PACE - 1:
            self._drift_static()
        reward += self._touch_static()
        if (self.steps + 1) % GROW_EVERY == 0:
            self._grow()
            if self._closed_in():
                self.lost = True
                reward -= 2.0
        if self.lives == 0:
            self.lost = True
        return reward

    def _walk(self, direction: int) -> float:
        dx, dy = DIRECTIONS[direction]
        if self.swapped:
            dx = -dx
        x, y = self.px + dx, self.py + dy
        if self.wall[y, x]:
            return 0.0
        self.px, self.py = x, y
        self.rest = WALK_PACE
        self.heat[y, x] += HEAT_PER_VISIT
        reward = 0.0
        if (x, y) not in self.touched:
            self.touched.add((x, y))
            reward += 0.01
        if (x, y) == self.goal:
            self.legs_done += 1
            self.touched = {(x, y)}
            reward += 2.0
            if self.legs_done == 2 * TRIPS:
                self.won = True
                reward += 4.0
        return reward

    def _drift_static(self) -> None:
        """Each burst steps to a neighbouring cell, the likelier the warmer it is."""
        for burst in self.bursts:
            ways = [(burst[0] + dx, burst[1] + dy) for dx, dy in DIRECTIONS.values()
                    if not self.wall[burst[1] + dy, burst[0] + dx]]
            if ways:
                weight = np.array([0.5 + self.heat[y, x] for x, y in ways])
                burst[:] = ways[int(self.np_random.choice(len(ways), p=weight / weight.sum()))]

    def _touch_static(self) -> float:
        for burst in self.bursts:
            if (burst[0], burst[1]) == (self.px, self.py):
                self.bursts.remove(burst)
                self._spawn_burst()
                self.lives -= 1
                return -1.0
        return 0.0

    def _grow(self) -> None:
        """The warmest cell in which nothing stands becomes a wall, the coldest inner wall opens."""
        busy = self.pinned | self.wall
        for x, y in [(self.px, self.py), self.antenna, self.note, *((b[0], b[1]) for b in self.bursts)]:
            busy[y, x] = True
        free = np.where(busy, -1.0, self.heat)
        warmest = int(np.argmax(free))
        inner = np.full((ROWS, COLS), np.inf)
        inner[1:-1, 1:-1] = np.where(self.wall, self.heat, np.inf)[1:-1, 1:-1]
        inner += self.np_random.random((ROWS, COLS)) * 0.1  # among walls as cold as each other, any may open
        coldest = int(np.argmin(inner))
        self.wall.flat[warmest] = True
        self.wall.flat[coldest] = False
        self.heat *= 0.97

    def _closed_in(self) -> bool:
        return all(self.wall[self.py + dy, self.px + dx] for dx, dy in DIRECTIONS.values())

    def _info(self) -> dict:
        return {"is_success": self.won, "trips": self.legs_done / 2, "lives": self.lives, "threads": self.threads_left}

    # ------------------------------------------------------------------ picture
    def render(self) -> np.ndarray:
        warmth = np.minimum(self.heat, 3.0)[..., None] / 3.0
        cells = (FLOOR + (WARM - FLOOR) * warmth).astype(np.uint8)
        cells[self.wall] = WALNUT
        frame = np.zeros((84, 84, 3), np.uint8)
        frame[TOP:] = cells.repeat(CELL, axis=0).repeat(CELL, axis=1)
        edges = self.wall.repeat(CELL, axis=0).repeat(CELL, axis=1)
        edges[1::2] = False
        frame[TOP:][edges] = WALNUT_EDGE
        for y, x in np.argwhere(self.pinned):
            frame[TOP + CELL * y + 4 : TOP + CELL * y + 6, CELL * x : CELL * x + CELL] = THREAD
        self._stamp(frame, ANTENNA_ART, *self.antenna, TAPE_BROWN if self.goal != self.antenna else DIAL_GREEN)
        self._stamp(frame, NOTE_ART, *self.note, NOTE_BLUE if self.goal != self.note else DIAL_GREEN)
        for x, y in self.bursts:
            self._stamp(frame, STATIC_ART, x, y, SIGNAL_RED)
        self._stamp(frame, ENGINEER_ART, self.px, self.py, ENGINEER)
        for k in range(2 * TRIPS):
            frame[1:5, 2 + 5 * k : 6 + 5 * k] = DIAL_GREEN if k < self.legs_done else (50, 50, 50)
        frame[2:4, 26 : 26 + 3 * self.threads_left : 3] = THREAD
        for k in range(self.lives):
            frame[1:5, 78 - 6 * k : 82 - 6 * k] = SIGNAL_RED
        if self.swapped:
            frame[[0, -1]] = SIGNAL_RED
            frame[:, [0, 1, -2, -1]] = SIGNAL_RED
        return frame

    @staticmethod
    def _stamp(frame: np.ndarray, art: np.ndarray, x: int, y: int, colour) -> None:
        frame[TOP + CELL * y : TOP + CELL * (y + 1), CELL * x : CELL * (x + 1)][art] = colour
