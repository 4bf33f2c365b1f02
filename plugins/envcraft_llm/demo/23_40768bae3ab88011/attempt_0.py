"""Rooftops: an alley cat puts out a field of 5 x 5 roof lamps.

A press switches the lamp under the cat and its four neighbours. The field is four presses away from dark and the cat
has 24 presses. It starts in the gutter below the field; a washing line hangs along the eave, and there is one gap in
it. With the first press the roof wakes up: a crow begins to meddle with the lamps and a puck begins to glide.
"""

import math

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 12
GRID = 7  # 7 x 7 cells of 12 pixels
FIELD = 5
FIRST, LAST = 1, 5  # the field covers columns and rows 1 to 5
GUTTER_ROW = 6
SCRAMBLE = 4
MAX_PRESSES = 24
LIVES = 4
MAX_STEPS = 1000

CROW_EVERY = 80
CROW_BLINKS = 15
STRENGTH = 50
REST_STEPS = 5
GOAL_WIDTH = 20
GOAL_LEFT = (84 - GOAL_WIDTH) // 2
PUCK_SPEED = 1.6
PUCK_KNOCK = 0.7
PUCK_HARD = 2.5
PUCK_FRICTION = 0.995

SLATE = (74, 80, 96)
SLATE_SEAM = (60, 66, 82)
BRICK = (156, 78, 62)
BRICK_DARK = (120, 56, 48)
SUNSET = (244, 142, 128)
SUNSET_DEEP = (196, 92, 118)
STREET = (40, 30, 52)
LAMP_LIT = (255, 220, 110)
LAMP_CORE = (255, 250, 216)
LAMP_OFF = (48, 52, 64)
CAT = (18, 16, 22)
CAT_EYES = (120, 230, 120)
CROW = (64, 40, 84)
CROW_BEAK = (240, 160, 40)
PUCK = (220, 60, 70)
LINEN = (230, 228, 236)
ROPE = (196, 184, 150)
TANK = (110, 118, 134)
BAR_BACK = (52, 40, 66)

STEP_OF = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


def lamp_tile(lit):
    rows, cols = np.indices((CELL, CELL))
    distance = np.hypot(rows - 5.5, cols - 5.5)
    tile = np.empty((CELL, CELL, 3), np.uint8)
    tile[:] = SLATE
    tile[0] = tile[:, 0] = SLATE_SEAM
    tile[distance < 4.6] = LAMP_LIT if lit else LAMP_OFF
    if lit:
        tile[distance < 2.4] = LAMP_CORE
    return tile


LIT_TILE, DARK_TILE = lamp_tile(True), lamp_tile(False)


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.presses_left = MAX_PRESSES
        self.strength = STRENGTH
        self.rest = 0
        self.button_was_down = False
        self.awake = False
        self.won = self.lost = False

        self.lamps = np.zeros((FIELD, FIELD), dtype=bool)
        for spot in self.np_random.permutation(FIELD * FIELD)[:SCRAMBLE].tolist():
            self._toggle(spot % FIELD, spot // FIELD)

        self.cat = (int(self.np_random.integers(FIRST, LAST + 1)), GUTTER_ROW)
        self._hang_washing_line()

        self.crow = (int(self.np_random.integers(FIRST, LAST + 1)), FIRST)
        self.crow_target = self.crow
        self.crow_clock = 0
        self.puck = [42.0, 42.0]
        self.puck_velocity = [0.0, 0.0]
        self.backdrop = self._paint_backdrop()
        return self.render(), self._info()

    def _hang_washing_line(self):
        """The line closes the eave between the gutter and the lowest row of lamps, but for one gap."""
        self.line = {(column, LAST) for column in range(FIRST, LAST + 1)}
        gap = int(self.np_random.integers(FIRST, LAST))
        self.line.discard((LAST, gap))

    # -- rules ----------------------------------------------------------------

    def _toggle(self, column, row):
        for dc, dr in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)):
            c, r = column + dc, row + dr
            if 0 <= c < FIELD and 0 <= r < FIELD:
                self.lamps[r, c] = not self.lamps[r, c]

    def on_field(self, cell):
        return FIRST <= cell[0] <= LAST and FIRST <= cell[1] <= LAST

    def can_walk(self, start, target):
        """The cat stays on the field and in the gutter, and cannot pass under the washing line."""
        column, row = target
        if not (FIRST <= column <= LAST and FIRST <= row <= GUTTER_ROW):
            return False
        crosses_eave = {start[1], row} == {LAST, GUTTER_ROW}
        return not (crosses_eave and (column, LAST) in self.line)

    def step(self, action):
        move, press, _ = (int(part) for part in action)
        self.steps += 1
        reward = 0.0
        if not (self.won or self.lost):
            reward += self._walk(move)
            if press and not self.button_was_down and self.on_field(self.cat):
                reward += self._press()
            self.button_was_down = bool(press)
            if self.awake and not self.won:
                reward += self._crow_turn() + self._glide()
            if not self.won and (self.presses_left == 0 or self.lives <= 0):
                self.lost = True
                reward -= 1.0
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), float(reward), terminated, truncated, self._info()

    def _walk(self, move):
        if move not in STEP_OF:
            if self.strength < STRENGTH:
                self.rest += 1
                if self.rest == REST_STEPS:
                    self.rest = 0
                    self.strength += 1
            return 0.0
        self.rest = 0
        dc, dr = STEP_OF[move]
        target = (self.cat[0] + dc, self.cat[1] + dr)
        if not self.can_walk(self.cat, target):
            return 0.0
        if move == 1:
            if self.strength == 0:
                self.cat = (self.cat[0], GUTTER_ROW)
                self.strength = STRENGTH // 2
                return self._hurt()
            self.strength -= 1
        self.cat = target
        self._knock(dc, dr)
        return 0.0

    def _press(self):
        before = int(self.lamps.sum())
        self._toggle(self.cat[0] - FIRST, self.cat[1] - FIRST)
        self.presses_left -= 1
        if not self.awake:
            self.awake = True
            angle = float(self.np_random.uniform(0.3, 1.2)) * (1 if self.np_random.integers(2) else -1)
            self.puck_velocity = [PUCK_SPEED * math.sin(angle), PUCK_SPEED * math.cos(angle)]
        after = int(self.lamps.sum())
        if after == 0:
            self.won = True
            return 5.0
        return 0.05 * (before - after)

    def _hurt(self):
        self.lives -= 1
        return -1.0

    def _crow_turn(self):
        self.crow_clock += 1
        if self.crow_clock == CROW_EVERY - CROW_BLINKS:
            self.crow_target = tuple((self.np_random.integers(FIRST, LAST + 1, size=2)).tolist())
        if self.crow_clock == CROW_EVERY:
            self.crow_clock = 0
            if self.crow_target != self.cat:
                self.crow = self.crow_target
                column, row = self.crow[0] - FIRST, self.crow[1] - FIRST
                self.lamps[row, column] = not self.lamps[row, column]
                if not self.lamps.any():
                    self.won = True
                    return 5.0
        return 0.0

    def _cat_box(self):
        return self.cat[0] * CELL + 1, self.cat[1] * CELL + 1, CELL - 2

    def _touches_puck(self):
        x, y, size = self._cat_box()
        return x - 2 <= self.puck[0] <= x + size + 2 and y - 2 <= self.puck[1] <= y + size + 2

    def _knock(self, dc, dr):
        if self.awake and self._touches_puck():
            self.puck_velocity[0] += PUCK_KNOCK * dc
            self.puck_velocity[1] += PUCK_KNOCK * dr

    def _glide(self):
        vx, vy = self.puck_velocity
        touched = self._touches_puck()
        self.puck[0] += vx
        self.puck[1] += vy
        if self.puck[1] <= CELL and GOAL_LEFT <= self.puck[0] <= GOAL_LEFT + GOAL_WIDTH:
            self.puck, self.puck_velocity = [42.0, 42.0], [vx, abs(vy)]
            return 0.5
        for axis, (low, high) in enumerate(((CELL + 2, 70), (CELL + 2, 82))):
            if not low <= self.puck[axis] <= high:
                self.puck[axis] = float(np.clip(self.puck[axis], low, high))
                self.puck_velocity[axis] = -self.puck_velocity[axis]
        speed = math.hypot(*self.puck_velocity)
        if not touched and self._touches_puck():
            self.puck_velocity = [-self.puck_velocity[0], -self.puck_velocity[1]]
            if speed > PUCK_HARD:
                return self._hurt()
        if speed > PUCK_SPEED:
            self.puck_velocity = [v * PUCK_FRICTION for v in self.puck_velocity]
        return 0.0

    def _info(self):
        return {
            "is_success": self.won,
            "lit": int(self.lamps.sum()),
            "presses_left": self.presses_left,
            "lives": self.lives,
            "strength": self.strength,
        }

    # -- picture --------------------------------------------------------------

    def _paint_backdrop(self):
        img = np.empty((84, 84, 3), np.uint8)
        img[:] = STREET
        for row in range(CELL):
            mix = row / CELL
            img[row] = [int(a * (1 - mix) + b * mix) for a, b in zip(SUNSET_DEEP, SUNSET)]
        for top in range(CELL, 84, 4):  # brick side walls
            img[top : top + 3, :CELL] = img[top : top + 3, 72:] = BRICK
            img[top + 3, :CELL] = img[top + 3, 72:] = BRICK_DARK
        img[20:32, 2:9] = TANK  # a water tank on the left, two on the right
        img[44:54, 75:82] = img[60:68, 74:80] = TANK
        img[72:84, CELL:72] = SLATE_SEAM
        img[81:84, CELL:72] = BRICK_DARK
        img[CELL - 1, GOAL_LEFT : GOAL_LEFT + GOAL_WIDTH] = PUCK
        return img

    def render(self):
        img = self.backdrop.copy()
        blink = self.awake and self.crow_clock >= CROW_EVERY - CROW_BLINKS and self.crow_clock % 2
        for row in range(FIELD):
            for column in range(FIELD):
                lit = self.lamps[row, column]
                if blink and self.crow_target == (column + FIRST, row + FIRST):
                    lit = not lit
                y, x = (row + FIRST) * CELL, (column + FIRST) * CELL
                img[y : y + CELL, x : x + CELL] = LIT_TILE if lit else DARK_TILE
        for column, row in self.line:
            y, x = (row + 1) * CELL, column * CELL
            img[y - 1, x : x + CELL] = ROPE
            img[y : y + 5, x + 2 : x + 5] = LINEN
            img[y : y + 4, x + 7 : x + 10] = SUNSET
        self._draw_crow(img)
        self._draw_cat(img)
        px, py = int(self.puck[0]), int(self.puck[1])
        img[py - 2 : py + 2, px - 2 : px + 2] = PUCK
        for life in range(self.lives):
            img[2:5, 2 + 5 * life : 6 + 5 * life] = CAT
        for press in range(self.presses_left):
            img[7:10, 2 + 2 * press] = LINEN
        img[2:5, 56:82] = BAR_BACK
        img[2:5, 56 : 56 + self.strength * 26 // STRENGTH] = CAT_EYES
        return img

    def _draw_crow(self, img):
        x, y = self.crow[0] * CELL, self.crow[1] * CELL
        img[y + 4 : y + 8, x + 3 : x + 9] = CROW
        img[y + 2 : y + 5, x + 7 : x + 10] = CROW
        img[y + 3, x + 10] = CROW_BEAK

    def _draw_cat(self, img):
        x, y = self.cat[0] * CELL, self.cat[1] * CELL
        img[y + 5 : y + 11, x + 2 : x + 10] = CAT
        img[y + 2 : y + 7, x + 3 : x + 9] = CAT
        img[y + 1, [x + 3, x + 8]] = CAT
        img[y + 4, [x + 4, x + 7]] = CAT_EYES
        img[y + 3 : y + 6, x + 10] = CAT
