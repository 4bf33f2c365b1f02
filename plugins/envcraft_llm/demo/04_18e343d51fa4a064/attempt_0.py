"""City Sewer: a plumber's robot digs six lost coins out of the earth and climbs back up the manhole ladder.

A board of 14 by 13 cells, full of earth. Digging into earth takes two steps, walking one. Valve wheels whose earth is
dug away fall after six steps. Button one changes the robot between light and dark: it swallows alligators of its own
colour and is bitten by the others. Button two winds the robot, and nothing else, back along its own way. It overheats
in the open and cools in the shadows of the valve wheels, which turn with the day.
"""

from collections import deque
from functools import cache

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
CELL = 6
COLUMNS, ROWS = 14, 13
TOP = 6
STEP_LIMIT = 900
LIVES = 4

COINS = 6
SHADELESS_COINS = 4
WHEELS = 7
WHEEL_DELAY = 6
FALL_PACE = 2

SWAP_PAUSE = 3
GATOR_EVERY = 12
GATOR_PACE = 2
MOST_PASSED = 25

MEMORY = 35
REWIND_PER_STEP = 2
TRAPS = 10
TRAP_DELAY = 12

HEAT_LIMIT = 80
COOLING = 4
DAY = 250
SHADOW_LENGTH = 3
COMPASS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

BRICK = (138, 58, 46)
MORTAR = (100, 42, 36)
TUNNEL = (38, 34, 36)
SLIME = (88, 170, 60)
PIPE = (130, 138, 146)
PIPE_DARK = (72, 78, 86)
LIGHT = (250, 240, 170)
DARK = (24, 24, 60)
COIN = (255, 214, 60)
TEETH = (220, 220, 220)
LADDER = (190, 150, 90)
SHADE = (20, 20, 40)


@cache
def brick_wall():
    """The board before anything is dug, drawn once."""
    wall = pygame.Surface((SIZE, SIZE))
    wall.fill(BRICK)
    for row in range(ROWS):
        wall.fill(MORTAR, (0, TOP + row * CELL + 5, SIZE, 1))
        for column in range(COLUMNS):
            wall.fill(MORTAR, (column * CELL + (2 if row % 2 else 5), TOP + row * CELL, 1, 5))
    return wall


@cache
def sprites():
    """The small things on the board, each on a transparent cell."""
    made = {}
    for name in ("shade", "trap", "trap set", "coin", "wheel"):
        made[name] = pygame.Surface((CELL, CELL))
        made[name].set_colorkey((0, 0, 0))
    made["shade"].fill(SHADE, (1, 1, 4, 4))
    for tooth in (0, 2, 4):
        made["trap"].fill(PIPE_DARK, (tooth, 4, 1, 2))
        made["trap set"].fill(TEETH, (tooth, 3, 1, 2))
    pygame.draw.circle(made["coin"], COIN, (3, 3), 2)
    pygame.draw.circle(made["wheel"], PIPE, (3, 3), 3)
    pygame.draw.circle(made["wheel"], PIPE_DARK, (3, 3), 1)
    return made


class GameEnv(gym.Env):
    """Dig, match colours, mind the heat, and rewind out of trouble."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.day = 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.tick = 0
        self.ladder = (0, 0)
        self.robot = self.ladder
        self.earth = np.ones((ROWS, COLUMNS), dtype=bool)
        self.earth[0, :2] = False
        self._bury_wheels()
        self._bury_coins()
        self._set_traps()
        self.trail = deque(maxlen=MEMORY)
        self.light = True
        self.swap_wait = 0
        self.busy = 0
        self.heat = 0
        self.charge = 0
        self.passed = 0
        self.lives = LIVES
        self.stunned = 0
        self.gators = []
        self.rewinding = False
        self.won = self.lost = False
        return self._picture(), self._info()

    # ---- building the board

    def _bury_wheels(self):
        self.wheels = []
        while len(self.wheels) < WHEELS:
            column, row = int(self.np_random.integers(2, 12)), int(self.np_random.integers(2, 10))
            if all(abs(column - w["at"][0]) + abs(row - w["at"][1]) > 2 for w in self.wheels):
                self.wheels.append({"at": (column, row), "wait": 0, "falling": False})

    def _bury_coins(self):
        """Four coins out of reach of every shadow, two wherever there is room."""
        self.coins = []
        taken = {wheel["at"] for wheel in self.wheels}
        under = {(column, row + 1) for column, row in taken}
        cells = [(c, r) for r in range(1, ROWS) for c in range(COLUMNS) if (c, r) not in taken | under]
        order = [cells[int(i)] for i in self.np_random.permutation(len(cells))]
        for cell in sorted(order, key=self._can_be_shaded):
            if len(self.coins) < SHADELESS_COINS and all(
                abs(cell[0] - c) + abs(cell[1] - r) > 2 for c, r in self.coins
            ):
                self.coins.append(cell)
        self.coins += [cell for cell in order if cell not in self.coins][: COINS - len(self.coins)]

    def _can_be_shaded(self, cell):
        reach = range(1, SHADOW_LENGTH + 1)
        return any(
            cell == (w["at"][0] + n * dx, w["at"][1] + n * dy) for w in self.wheels for dx, dy in COMPASS for n in reach
        )

    def _set_traps(self):
        taken = {wheel["at"] for wheel in self.wheels} | set(self.coins) | {self.ladder}
        cells = [(c, r) for r in range(ROWS) for c in range(COLUMNS) if (c, r) not in taken]
        chosen = self.np_random.choice(len(cells), TRAPS, replace=False)
        self.traps = {cells[int(i)]: 0 for i in chosen}

    # ---- rules

    def shadows(self):
        """The cells that lie in a wheel's shadow now; shadows turn round once a day."""
        dx, dy = COMPASS[self.day * len(COMPASS) // DAY % len(COMPASS)]
        return {(w["at"][0] + n * dx, w["at"][1] + n * dy) for w in self.wheels for n in range(1, SHADOW_LENGTH + 1)}

    def step(self, action):
        move, swap, rewind = int(action[0]), bool(action[1]), bool(action[2])
        reward = 0.0
        if not (self.won or self.lost):
            self.tick += 1
            self.day += 1
            self.stunned = max(0, self.stunned - 1)
            self._change_colour(swap)
            self.rewinding = rewind
            if self.rewinding:
                self._rewind()
            else:
                reward += self._walk(move)
            reward += self._drop_wheels() + self._spring_traps() + self._fly_gators() + self._warm_up()
            self.won = not self.coins and self.robot == self.ladder
            self.lost = not self.won and (self.lives <= 0 or self.passed >= MOST_PASSED)
            reward += 5.0 * self.won - 1.0 * self.lost
        terminated = self.won or self.lost
        truncated = self.tick >= STEP_LIMIT and not terminated
        return self._picture(), float(reward), terminated, truncated, self._info()

    def _change_colour(self, swap):
        self.swap_wait = max(0, self.swap_wait - 1)
        if swap and not self.swap_wait:
            self.light = not self.light
            self.swap_wait = SWAP_PAUSE

    def _rewind(self):
        for _ in range(REWIND_PER_STEP):
            self.robot = self.trail.pop()
        self.busy = 0

    def _walk(self, move):
        if self.busy:
            self.busy -= 1
            return 0.0
        if move not in MOVES:
            return 0.0
        dx, dy = MOVES[move]
        column, row = self.robot[0] + dx, self.robot[1] + dy
        if not (0 <= column < COLUMNS and 0 <= row < ROWS) or any(w["at"] == (column, row) for w in self.wheels):
            return 0.0
        self.trail.append(self.robot)
        self.robot = (column, row)
        if self.earth[row, column]:
            self.earth[row, column] = False
            self.busy = 1
        if self.robot in self.traps and not self.traps[self.robot]:
            self.traps[self.robot] = TRAP_DELAY
        if self.robot in self.coins:
            self.coins.remove(self.robot)
            return 1.0
        return 0.0

    def _lose_life(self):
        if self.stunned or self.rewinding:
            return 0.0
        self.lives -= 1
        self.stunned = 15
        return -1.0

    def _drop_wheels(self):
        reward = 0.0
        for wheel in self.wheels:
            column, row = wheel["at"]
            below = (column, row + 1)
            supported = row + 1 >= ROWS or self.earth[row + 1, column] or any(w["at"] == below for w in self.wheels)
            if supported or (below == self.robot and not wheel["falling"]):
                wheel["wait"], wheel["falling"] = 0, False
                continue
            wheel["wait"] += 1
            if wheel["wait"] < (FALL_PACE if wheel["falling"] else WHEEL_DELAY):
                continue
            wheel["wait"], wheel["falling"] = 0, True
            wheel["at"] = below
            if below == self.robot:
                reward += self._lose_life()
                self.robot = self.trail.pop() if self.trail else self.ladder
        return reward

    def _spring_traps(self):
        reward = 0.0
        for cell, wait in list(self.traps.items()):
            if wait == 1:
                del self.traps[cell]
                if cell == self.robot:
                    reward += self._lose_life()
            elif wait:
                self.traps[cell] = wait - 1
        return reward

    def _fly_gators(self):
        reward = 0.0
        if self.tick % GATOR_EVERY == 0:
            row = self.robot[1] if self.np_random.random() < 0.6 else int(self.np_random.integers(ROWS))
            side = int(self.np_random.integers(2))
            light = bool(self.np_random.integers(2))
            self.gators.append({"x": -1 if side else COLUMNS, "row": row, "way": 1 if side else -1, "light": light})
        if self.tick % GATOR_PACE:
            return 0.0
        staying = []
        for gator in self.gators:
            gator["x"] += gator["way"]
            if (gator["x"], gator["row"]) == self.robot and not self.rewinding:
                if gator["light"] == self.light:
                    self.charge += 1
                    reward += 0.1
                else:
                    reward += self._lose_life()
            elif 0 <= gator["x"] < COLUMNS:
                staying.append(gator)
            else:
                self.passed += 1
        self.gators = staying
        return reward

    def _warm_up(self):
        self.heat = max(0, self.heat - COOLING) if self.robot in self.shadows() else self.heat + 1
        if self.heat < HEAT_LIMIT:
            return 0.0
        self.heat = HEAT_LIMIT // 2
        return self._lose_life()

    def _info(self):
        return {"is_success": self.won, "coins_left": len(self.coins), "lives": self.lives, "passed": self.passed}

    # ---- picture

    def render(self):
        return self._picture()

    def _picture(self):
        canvas = brick_wall().copy()
        for row, column in np.argwhere(~self.earth).tolist():
            canvas.fill(TUNNEL, (column * CELL, TOP + row * CELL, CELL, CELL))
        canvas.fill(SLIME, (0, SIZE - 2, SIZE, 2))
        pictures = sprites()
        things = [("shade", cell) for cell in sorted(self.shadows())]
        things += [("trap set" if wait else "trap", cell) for cell, wait in self.traps.items()]
        things += [("coin", cell) for cell in self.coins]
        things += [("wheel", wheel["at"]) for wheel in self.wheels]
        canvas.blits([(pictures[name], (column * CELL, TOP + row * CELL)) for name, (column, row) in things])
        for rung in range(3):
            canvas.fill(LADDER, (1, TOP + 2 * rung, 4, 1))
        for gator in self.gators:
            left, top = gator["x"] * CELL, TOP + gator["row"] * CELL + 1
            canvas.fill(LIGHT if gator["light"] else DARK, (left, top, 6, 4))
            canvas.fill(SLIME, (left, top + 3, 6, 1))
        self._draw_robot(canvas)
        self._draw_bars(canvas)
        return np.ascontiguousarray(pygame.surfarray.array3d(canvas).swapaxes(0, 1))

    def _draw_robot(self, canvas):
        left, top = self.robot[0] * CELL, TOP + self.robot[1] * CELL
        warmth = min(1.0, self.heat / HEAT_LIMIT)
        canvas.fill((int(60 + 190 * warmth), 60, int(250 - 190 * warmth)), (left, top, 6, 6))
        if self.stunned % 4 < 2:
            canvas.fill(LIGHT if self.light else DARK, (left + 1, top + 1, 4, 4))
        if self.rewinding:
            canvas.fill(TEETH, (left + 2, top + 2, 2, 2))

    def _draw_bars(self, canvas):
        canvas.fill((0, 0, 0), (0, 0, SIZE, TOP))
        for life in range(self.lives):
            canvas.fill(PIPE, (2 + 4 * life, 1, 3, 3))
        for coin in range(len(self.coins)):
            canvas.fill(COIN, (22 + 3 * coin, 1, 2, 3))
        canvas.fill(SLIME, (42, 1, self.passed, 1))
        canvas.fill((230, 70, 50), (42, 3, self.heat * 25 // HEAT_LIMIT, 1))
        canvas.fill(LIGHT, (70, 1, min(12, self.charge), 2))
