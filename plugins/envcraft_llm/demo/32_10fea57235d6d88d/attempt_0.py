"""Ghost Ship: push three sea chests onto the marked planks of a tilted deck, between pulses that sweep it clear.

The castaway walks a cell a move and pushes single chests; nothing can be pulled. Every 110 steps a ring runs outwards
from the middle of the deck and throws back whoever is not standing still as it passes.
"""

from __future__ import annotations

from collections import deque

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 8
COLS, ROWS = 10, 9
LEFT, TOP = 2, 8
MAX_STEPS = 950
CHESTS = 5
MARKS = 3
MASTS = 4

PULSE_PERIOD = 110
PULSE_SPEED = 4
PULSE_BACK = 1  # cells: 8 pixels
PULSE_END = 64
WALK_REST = 2

FOG = (108, 118, 124)
FOG_LIGHT = (126, 136, 140)
WOOD = (66, 58, 50)
WOOD_GAP = (52, 46, 40)
HULL = (38, 34, 32)
LAMP = (140, 255, 170)
BONE = (232, 226, 206)
CHEST = (134, 92, 50)
CHEST_BAND = (200, 172, 96)
CHEST_HOME = (90, 160, 100)
COAT = (60, 90, 140)

STEP = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}

    def __init__(self, render_mode: str | None = "rgb_array"):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        ys, xs = np.indices((84, 84))
        self._from_middle = np.hypot(xs - 41.5, ys - (TOP + ROWS * CELL / 2))

    # ------------------------------------------------------------------ the deck

    def reset(self, *, seed: int | None = None, options: dict | None = None):
        super().reset(seed=seed)
        self.steps = 0
        self.rest = 0
        self.ring: float | None = None
        self.thrown = 0
        self.stuck = False
        self.won = False
        while not self._load_deck():
            pass
        self.best = self.home()
        self.deck = self._paint_deck()
        return self.render(), self._info()

    def _load_deck(self) -> bool:
        """Chests start on their marks and are pulled away from them, so that pushing them back is possible."""
        inner = [(x, y) for x in range(1, COLS - 1) for y in range(1, ROWS - 1)]
        picked = [inner[i] for i in self.np_random.permutation(len(inner))]
        self.masts = set(picked[:MASTS])
        self.marks = picked[MASTS : MASTS + MARKS]
        chests = list(self.marks)
        spare = [cell for cell in picked[MASTS + MARKS :] if 2 <= cell[0] <= COLS - 3 and 2 <= cell[1] <= ROWS - 3]
        chests += spare[: CHESTS - MARKS]
        self.chests = chests
        self.x, self.y = picked[-1]
        if len(chests) < CHESTS or (self.x, self.y) in chests:
            return False
        for number in range(MARKS):
            pulls = 0
            for _ in range(40):
                pulls += self._pull(number, int(self.np_random.integers(1, 5)))
                if pulls >= 8:
                    break
        spread = [min(abs(x - a) + abs(y - b) for a, b in self.marks) for x, y in self.chests[:MARKS]]
        return self.home() == 0 and min(spread) >= 2 and not self._beyond_hope()

    def _pull(self, number: int, direction: int) -> bool:
        """Pull one chest a cell, if the castaway can walk to where it would stand to do so."""
        dx, dy = STEP[direction]
        cx, cy = self.chests[number]
        stand, back = (cx + dx, cy + dy), (cx + 2 * dx, cy + 2 * dy)
        if not (self._free(*stand) and self._free(*back)) or stand not in self._walkable():
            return False
        self.chests[number] = stand
        self.x, self.y = back
        return True

    def _walkable(self) -> set[tuple[int, int]]:
        seen, queue = {(self.x, self.y)}, deque([(self.x, self.y)])
        while queue:
            x, y = queue.popleft()
            for dx, dy in STEP.values():
                cell = (x + dx, y + dy)
                if cell not in seen and self._free(*cell):
                    seen.add(cell)
                    queue.append(cell)
        return seen

    def _on_deck(self, x: int, y: int) -> bool:
        return 0 <= x < COLS and 0 <= y < ROWS and (x, y) not in self.masts

    def _free(self, x: int, y: int) -> bool:
        return self._on_deck(x, y) and (x, y) not in self.chests

    def home(self) -> int:
        """How many marks have a chest on them."""
        return sum(mark in self.chests for mark in self.marks)

    def _beyond_hope(self) -> bool:
        """Whether so many chests are wedged in corners that the marks can no longer all be filled."""
        wedged = 0
        for x, y in self.chests:
            if (x, y) in self.marks:
                continue
            beside = not self._on_deck(x - 1, y) or not self._on_deck(x + 1, y)
            above = not self._on_deck(x, y - 1) or not self._on_deck(x, y + 1)
            wedged += beside and above
        return CHESTS - wedged < MARKS

    # ------------------------------------------------------------------ a step

    def step(self, action):
        direction = int(action[0])
        if self.won or self.stuck:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        reward = -0.002
        self.rest = max(0, self.rest - 1)
        moved = False
        if direction and not self.rest:
            moved = self._walk(*STEP[direction])
        self._pulse(still=direction == 0)
        if moved:
            self.rest = WALK_REST
        count = self.home()
        if count > self.best:
            self.best = count
            reward += 1.0
        if count == MARKS:
            self.won = True
            reward += 4.0
        elif self._beyond_hope():
            self.stuck = True
            reward -= 1.0
        terminated = self.won or self.stuck
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.render(), reward, terminated, truncated, self._info()

    def _walk(self, dx: int, dy: int) -> bool:
        x, y = self.x + dx, self.y + dy
        if (x, y) in self.chests:
            if not self._free(x + dx, y + dy):
                return False
            self.chests[self.chests.index((x, y))] = (x + dx, y + dy)
        elif not self._on_deck(x, y):
            return False
        self.x, self.y = x, y
        return True

    def _pulse(self, still: bool) -> None:
        if self.ring is not None:
            before, self.ring = self.ring, self.ring + PULSE_SPEED
            dx = LEFT + self.x * CELL + CELL / 2 - 42
            dy = self.y * CELL + CELL / 2 - ROWS * CELL / 2
            if before <= float(np.hypot(dx, dy)) < self.ring and not still:
                outward = (int(np.sign(dx)), 0) if abs(dx) >= abs(dy) else (0, int(np.sign(dy)))
                if outward != (0, 0) and self._free(self.x + outward[0], self.y + outward[1]):
                    self.x += outward[0] * PULSE_BACK
                    self.y += outward[1] * PULSE_BACK
                self.thrown += 1
            if self.ring > PULSE_END:
                self.ring = None
        elif self.steps % PULSE_PERIOD == 0:
            self.ring = 0.0

    def _info(self) -> dict:
        return {"is_success": self.won, "home": self.home(), "thrown": self.thrown, "steps": self.steps}

    # ------------------------------------------------------------------ the picture

    def _corner(self, cell: tuple[int, int]) -> tuple[int, int]:
        return LEFT + cell[0] * CELL, TOP + cell[1] * CELL

    def _paint_deck(self) -> np.ndarray:
        canvas = np.full((84, 84, 3), HULL, np.uint8)
        canvas[TOP : TOP + ROWS * CELL, LEFT : LEFT + COLS * CELL] = WOOD
        for y in range(TOP, TOP + ROWS * CELL, 4):
            shift = (y * 5) % 17
            canvas[y, LEFT : LEFT + COLS * CELL] = WOOD_GAP
            canvas[y : y + 4, LEFT + shift : LEFT + COLS * CELL : 24] = WOOD_GAP
        for mark in self.marks:
            x, y = self._corner(mark)
            canvas[[y + 1, y + CELL - 2], x + 1 : x + CELL - 1] = LAMP
            canvas[y + 1 : y + CELL - 1, [x + 1, x + CELL - 2]] = LAMP
        for mast in self.masts:
            x, y = self._corner(mast)
            canvas[y + 1 : y + 7, x + 1 : x + 7] = (94, 84, 72)
            canvas[y + 2 : y + 6, x + 2 : x + 6] = (120, 108, 92)
        return canvas

    def render(self) -> np.ndarray:
        frame = self.deck.copy()
        # Wisps of fog drift over the deck, row by row.
        for k, y in enumerate(range(TOP + 3, 80, 9)):
            start = (self.steps // 3 + 29 * k) % 100 - 16
            frame[y, max(0, start) : max(0, start + 14)] = FOG
            frame[y + 1, max(0, start + 3) : max(0, start + 10)] = FOG_LIGHT
        for chest in self.chests:
            x, y = self._corner(chest)
            frame[y + 1 : y + 7, x : x + 8] = CHEST_HOME if chest in self.marks else CHEST
            frame[y + 3, x : x + 8] = CHEST_BAND
            frame[y + 1 : y + 7, x + 3 : x + 5] = CHEST_BAND
        x, y = self._corner((self.x, self.y))
        frame[y + 3 : y + 7, x + 1 : x + 7] = COAT
        frame[y : y + 3, x + 2 : x + 6] = BONE
        if self.ring is not None:
            band = np.abs(self._from_middle - self.ring) < 1.2
            band[:TOP] = False
            frame[band] = LAMP
        for k in range(MARKS):
            frame[2:6, 3 + 7 * k : 8 + 7 * k] = CHEST_HOME if k < self.home() else (70, 66, 62)
        until = PULSE_PERIOD - self.steps % PULSE_PERIOD
        frame[3:5, 82 - until // 2 : 82] = LAMP
        return frame
