"""Clockwork Tower: the clockmaker drags a growing chain of springs along iron walkways.

The clockmaker never stands still: every second step it moves one cell in the last direction chosen, pulling a chain
behind it that each spring makes one link longer. The great bell hangs at one of three places and moves on every 160
steps, glowing before it does; passing under it rings it once per stay. The game is won with a chain of 25 links, lost
by running into the own chain or the edge of the tower.
"""

from collections import deque

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
CELL = 3
GRID = 27
TOP = 3
SIDE = 1
STEP_LIMIT = 950

TARGET_LENGTH = 25
START_LENGTH = 3
PACE = 2
GROWTH = 1

BELL_PLACES = ((5, 5), (20, 8), (11, 20))
BELL_PERIOD = 160
BELL_WARNING = 25
BELL_REACH = 1

SPRING_REWARD = 1.0
BELL_REWARD = 0.3
WIN_REWARD = 5.0
LOSS = -1.0

SOOT = (24, 20, 20)
IRON = (58, 60, 66)
IRON_LIGHT = (74, 76, 84)
BRASS = (196, 160, 72)
BRASS_DARK = (92, 74, 36)
COPPER = (206, 96, 60)
COPPER_DARK = (142, 66, 42)
SPRING = (236, 236, 240)
BELL = (250, 206, 80)
BELL_GLOW = (255, 244, 190)
COAT = (90, 170, 220)

UP, DOWN, LEFT, RIGHT = (0, -1), (0, 1), (-1, 0), (1, 0)
DIRECTIONS = {1: UP, 2: DOWN, 3: LEFT, 4: RIGHT}


class GameEnv(gym.Env):
    """A growing body in a tower whose bell will not stay where it is."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.tower = self._draw_tower()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.springs_taken = 0
        self.heading = tuple(DIRECTIONS.values())[int(self.np_random.integers(4))]
        self.wanted = self.heading
        # A little behind the middle, so that there is time to look round before the edge comes near.
        (dx, dy), middle, aside = self.heading, GRID // 2, int(self.np_random.integers(-1, 2))
        head = (middle - 2 * dx + aside * dy, middle - 2 * dy + aside * dx)
        # Newest cell first. The whole way is kept for the worn marks on the floor; the body is its first part.
        chain = [(head[0] - n * dx, head[1] - n * dy) for n in range(START_LENGTH)]
        self.way = deque(chain, maxlen=2 * TARGET_LENGTH)
        self.length = START_LENGTH
        self.won = self.crashed = False
        self.bell = int(self.np_random.integers(len(BELL_PLACES)))
        self.next_bell = self._other_bell()
        self.rung = False
        self.spring = self._free_cell()
        return self._draw(), self._info()

    # -- helpers ---------------------------------------------------------------

    @property
    def body(self):
        return list(self.way)[: self.length]

    def _free_cell(self):
        taken = set(self.body)
        while True:
            cell = (int(self.np_random.integers(1, GRID - 1)), int(self.np_random.integers(1, GRID - 1)))
            if cell not in taken:
                return cell

    def _other_bell(self):
        others = [number for number in range(len(BELL_PLACES)) if number != self.bell]
        return others[int(self.np_random.integers(len(others)))]

    def _inside(self, cell):
        return 0 <= cell[0] < GRID and 0 <= cell[1] < GRID

    # -- rules -----------------------------------------------------------------

    def step(self, action):
        reward = 0.0
        if not (self.won or self.crashed):
            self.steps += 1
            self._choose(int(action[0]))
            if self.steps % PACE == 0:
                reward += self._advance()
            self._move_bell()
        terminated = self.won or self.crashed
        truncated = self.steps >= STEP_LIMIT and not terminated
        return self._draw(), float(reward), terminated, truncated, self._info()

    def _choose(self, move):
        """Remember the last direction chosen; turning straight back is impossible."""
        wanted = DIRECTIONS.get(move)
        if wanted is not None and (wanted[0] + self.heading[0], wanted[1] + self.heading[1]) != (0, 0):
            self.wanted = wanted

    def _advance(self):
        self.heading = self.wanted
        head = (self.way[0][0] + self.heading[0], self.way[0][1] + self.heading[1])
        if not self._inside(head) or head in self.body[:-1]:
            self.crashed = True
            return LOSS
        self.way.appendleft(head)
        reward = 0.0
        if head == self.spring:
            self.springs_taken += 1
            self.length += GROWTH
            self.spring = self._free_cell()
            reward += SPRING_REWARD
        reward += self._ring(head)
        if len(self.way) >= TARGET_LENGTH:
            self.won = True
            reward += WIN_REWARD
        return reward

    def _ring(self, head):
        column, row = BELL_PLACES[self.bell]
        if self.rung or abs(head[0] - column) > BELL_REACH or abs(head[1] - row) > BELL_REACH:
            return 0.0
        self.rung = True
        return BELL_REWARD

    def _move_bell(self):
        if self.steps % BELL_PERIOD == 0:
            self.bell = self.next_bell
            self.next_bell = self._other_bell()
            self.rung = False

    def _info(self):
        return {"is_success": self.won, "length": self.length, "springs": self.springs_taken}

    # -- picture ---------------------------------------------------------------

    def render(self):
        return self._draw()

    @staticmethod
    def _draw_tower():
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        image[:] = SOOT
        yy, xx = np.ogrid[:SIZE, :SIZE]
        for cx, cy, radius in ((20, 62, 17), (58, 28, 22), (70, 72, 10)):
            ring = np.hypot(xx - cx, yy - cy)
            teeth = (np.arctan2(yy - cy, xx - cx) * 8 / np.pi).astype(int) % 2 == 0
            image[(np.abs(ring - radius) < 1.5) | ((np.abs(ring - radius - 2) < 1.5) & teeth)] = BRASS_DARK
            image[ring < 3] = BRASS_DARK
        area = image[TOP : TOP + GRID * CELL, SIDE : SIDE + GRID * CELL]
        area[::CELL, ::CELL] = IRON_LIGHT
        image[TOP:, :SIDE] = image[TOP:, -SIDE:] = IRON
        image[TOP - 1] = image[-1] = IRON
        image[: TOP - 1] = (0, 0, 0)
        return image

    @staticmethod
    def _cell(image, cell, colour, inset=0):
        left, top = SIDE + cell[0] * CELL, TOP + cell[1] * CELL
        image[top + inset : top + CELL - inset, left + inset : left + CELL - inset] = colour

    def _draw(self):
        image = self.tower.copy()
        for cell in list(self.way)[self.length :]:
            self._cell(image, cell, IRON, inset=1)
        self._draw_bell(image, BELL_PLACES[self.bell], BELL if not self.rung else BRASS)
        until = BELL_PERIOD - self.steps % BELL_PERIOD
        if until <= BELL_WARNING and until % 4 < 2:
            self._draw_bell(image, BELL_PLACES[self.next_bell], BELL_GLOW)
        self._cell(image, self.spring, SPRING)
        self._cell(image, self.spring, SOOT, inset=1)
        for number, cell in enumerate(self.body):
            self._cell(image, cell, COPPER if number % 2 else COPPER_DARK)
        self._cell(image, self.way[0], COAT)
        image[1:3, 2 : 2 + 3 * self.length] = BRASS
        image[1:3, 2 + 3 * TARGET_LENGTH] = BELL_GLOW
        return image

    @staticmethod
    def _draw_bell(image, place, colour):
        left, top = SIDE + place[0] * CELL, TOP + place[1] * CELL
        image[top - 2 : top + 5, left : left + 4] = colour
        image[top + 4 : top + 6, left - 2 : left + 6] = colour
