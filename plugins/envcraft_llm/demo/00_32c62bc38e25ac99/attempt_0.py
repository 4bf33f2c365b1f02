"""Ring Station: fly the cadet's capsule through the hull and set it down on the narrow pad behind the ridge.

The capsule is pulled down by the station's weak gravity. Up burns the main engine along the capsule's own axis, left
and right turn it by 20 degrees, button one lowers (or raises) the landing legs, button two drops a small tower.
Larvae walk the ceiling duct towards the escape pod and must be stopped by towers; a hunter follows the capsule and
only flees after the flashing fruit has been taken. Touching the ground wrongly ends the game at once.
"""

import math

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
STEP_LIMIT = 900

GRAVITY = 0.04
ENGINE = 0.10
TURN = 20
SOFT_LANDING = 1.2
TANK = 350.0
CELL_REFILL = 35.0
LEG_STEPS = 20

LIVES = 2
HUNTER_SHARE = 0.70
FLEE_STEPS = 60
FRUIT_EVERY = 120

LARVA_EVERY = 50
LARVA_SPEED = 0.35
ROAD_Y = 10
POD_X = 78
TOWER_REACH = 12
TOWER_RELOAD = 12
TOWERS = 3

HULL_WHITE = (226, 230, 236)
PANEL_TEAL = (34, 108, 112)
PANEL_DARK = (18, 52, 60)
ALARM_RED = (232, 60, 56)
VIOLET = (24, 16, 44)
STAR = (150, 140, 190)
ROCK = (96, 84, 110)
ROCK_EDGE = (150, 138, 166)
PAD_WIDE = (120, 200, 150)
PAD_NARROW = (255, 226, 90)
LARVA = (150, 220, 70)
FLAME = (255, 150, 50)
CELL_BLUE = (90, 190, 255)
POD = (240, 240, 120)
TOWER = (200, 120, 230)


class GameEnv(gym.Env):
    """A lander with a pursuer in the air and a road to guard on the ceiling."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ set-up

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.x = 12.0 + float(self.np_random.integers(0, 5))
        self.y = 20.0
        self.vx = self.vy = 0.0
        self.angle = 0
        self.burning = False
        self.fuel = TANK
        self.legs = 0
        self.legs_wanted = False
        self.leg_button_held = False
        self.resting = False
        self.won = self.lost = False
        self._build_ground()
        self.hunter = [4.0, 46.0]
        self.flee = 0
        self.fruit = None
        self.larvae = []
        self.towers = []
        self.flash = 0
        self._place_cells()
        self.backdrop = self._paint_backdrop()
        self.distance = self._pad_distance()
        return self._frame(), self._info()

    def _build_ground(self):
        """Rough heights by midpoint noise, a wide pad on the left, a ridge, and a narrow pad behind it."""
        noise = self.np_random.integers(-3, 4, size=15)
        knots = 72 + noise
        self.ground = np.interp(np.arange(SIZE), np.arange(15) * 6, knots)
        self.wide_pad = (int(self.np_random.integers(12, 18)), 16)
        ridge = int(self.np_random.integers(40, 46))
        peak = float(self.np_random.integers(48, 55))
        slope = peak + np.abs(np.arange(SIZE) - ridge) * 1.9
        self.ground = np.minimum(self.ground, slope)
        self.narrow_pad = (int(self.np_random.integers(60, 66)), 10)
        for left, width in (self.wide_pad, self.narrow_pad):
            self.ground[left : left + width] = 74
        self.ground = np.floor(self.ground).astype(np.int64)
        self.ridge_top = int(self.ground.min())

    def _place_cells(self):
        xs = (26, 44, 62)
        self.cells = [(x + int(self.np_random.integers(-3, 4)), int(self.np_random.integers(26, 40))) for x in xs]

    def _pad_distance(self):
        left, width = self.narrow_pad
        return math.hypot(self.x - (left + width / 2), self.y - 70)

    # ------------------------------------------------------------------ rules

    def step(self, action):
        move, leg_button, tower_button = (int(part) for part in action)
        reward = 0.0
        if not (self.won or self.lost):
            self.steps += 1
            self.flash = max(0, self.flash - 1)
            self._steer(move)
            self._work_legs(leg_button)
            if tower_button:
                self._drop_tower()
            self._fly()
            reward += self._collect()
            reward += self._move_larvae()
            reward += self._move_hunter()
            reward += self._touch_ground()
            nearer = self._pad_distance()
            reward += 0.01 * (self.distance - nearer)
            self.distance = nearer
            if self.lives <= 0:
                self.lost = True
        terminated = self.won or self.lost
        truncated = self.steps >= STEP_LIMIT and not terminated
        return self._frame(), float(reward), terminated, truncated, self._info()

    def _steer(self, move):
        self.burning = False
        if move == 1 and self.fuel >= 1.0:
            self.burning = True
            self.fuel -= 1.0
            heading = math.radians(self.angle)
            self.vx += ENGINE * math.sin(heading)
            self.vy -= ENGINE * math.cos(heading)
            self.resting = False
        elif move in (3, 4) and not self.resting:
            self.angle += TURN if move == 4 else -TURN
            self.angle = (self.angle + 180) % 360 - 180

    def _work_legs(self, button):
        """A press begins lowering or raising; the legs then take twenty steps to travel."""
        if button and not self.leg_button_held:
            self.legs_wanted = not self.legs_wanted
        self.leg_button_held = bool(button)
        self.legs = min(LEG_STEPS, self.legs + 1) if self.legs_wanted else max(0, self.legs - 1)

    def _drop_tower(self):
        near = any(abs(t[0] - self.x) + abs(t[1] - self.y) < 6 for t in self.towers)
        if len(self.towers) < TOWERS and not near:
            self.towers.append([self.x, self.y, 0])

    def _fly(self):
        if self.resting:
            return
        self.vy += GRAVITY
        self.x += self.vx
        self.y += self.vy
        if self.x < 3 or self.x > SIZE - 4:
            self.x = min(max(self.x, 3.0), SIZE - 4.0)
            self.vx *= -0.3
        if self.y < ROAD_Y + 5:
            self.y = ROAD_Y + 5.0
            self.vy = max(0.0, self.vy)

    def _collect(self):
        reward = 0.0
        for cell in list(self.cells):
            if abs(cell[0] - self.x) < 5 and abs(cell[1] - self.y) < 5:
                self.cells.remove(cell)
                self.fuel = min(TANK, self.fuel + CELL_REFILL)
                reward += 0.3
        if self.steps % FRUIT_EVERY == 0:
            self.fruit = (int(self.np_random.integers(8, SIZE - 8)), int(self.np_random.integers(22, 40)))
        if self.fruit and abs(self.fruit[0] - self.x) < 5 and abs(self.fruit[1] - self.y) < 5:
            self.fruit = None
            self.flee = FLEE_STEPS
            reward += 0.5
        return reward

    def _move_larvae(self):
        reward = 0.0
        if self.steps % LARVA_EVERY == 0:
            self.larvae.append(2.0)
        self.larvae = [x + LARVA_SPEED for x in self.larvae]
        for tower in self.towers:
            tower[2] = max(0, tower[2] - 1)
            if tower[2]:
                continue
            hit = next((x for x in self.larvae if math.hypot(x - tower[0], ROAD_Y - tower[1]) <= TOWER_REACH), None)
            if hit is not None:
                self.larvae.remove(hit)
                tower[2] = TOWER_RELOAD
                reward += 0.2
        through = sum(x >= POD_X - 3 for x in self.larvae)
        if through:
            self.larvae = [x for x in self.larvae if x < POD_X - 3]
            reward += self._lose_lives(through)
        return reward

    def _move_hunter(self):
        """Straight towards the capsule, at seventy percent of the capsule's own speed; away from it while fleeing."""
        dx, dy = self.x - self.hunter[0], self.y - self.hunter[1]
        gap = math.hypot(dx, dy) or 1.0
        pace = HUNTER_SHARE * max(math.hypot(self.vx, self.vy), 0.1)
        if self.flee:
            self.flee -= 1
            pace = -pace
        self.hunter[0] = min(max(self.hunter[0] + pace * dx / gap, 3.0), SIZE - 4.0)
        self.hunter[1] = min(max(self.hunter[1] + pace * dy / gap, 16.0), SIZE - 4.0)
        if gap < 4 and not self.flee:
            self.hunter = [4.0, 46.0] if self.x > SIZE / 2 else [SIZE - 5.0, 30.0]
            return self._lose_lives(1)
        return 0.0

    def _lose_lives(self, count):
        self.lives = max(0, self.lives - count)
        self.flash = 4
        return -1.0 * count

    def _touch_ground(self):
        foot = self.y + 4
        left, right = int(self.x) - 2, int(self.x) + 2
        if self.resting or foot < self.ground[left : right + 1].min():
            return 0.0
        pad = next((p for p in (self.wide_pad, self.narrow_pad) if p[0] <= left and right < p[0] + p[1]), None)
        gentle = math.hypot(self.vx, self.vy) <= SOFT_LANDING
        if pad is None or not gentle or self.angle != 0 or self.legs < LEG_STEPS:
            self.lost = True
            return -2.0
        self.y = self.ground[left] - 4.0
        self.vx = self.vy = 0.0
        self.resting = True
        if pad == self.narrow_pad:
            self.won = True
            return 5.0
        return 0.0

    def _info(self):
        return {"is_success": self.won, "lives": self.lives, "fuel": self.fuel}

    # ------------------------------------------------------------------ picture

    def render(self):
        return self._frame()

    def _paint_backdrop(self):
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        image[:] = VIOLET
        image[::14, :] = PANEL_DARK
        image[:, ::21] = PANEL_DARK
        for cx, cy in ((20, 32), (52, 28), (72, 46)):
            yy, xx = np.ogrid[:SIZE, :SIZE]
            ring = (xx - cx) ** 2 + (yy - cy) ** 2
            image[ring <= 36] = PANEL_TEAL
            image[ring <= 20] = (8, 6, 20)
        stars = self.np_random.integers(16, 60, size=(24, 2))
        image[stars[:, 0], (stars[:, 1] * 5) % SIZE] = STAR
        rows = np.arange(SIZE)[:, None]
        image[rows >= self.ground[None, :]] = ROCK
        image[rows == self.ground[None, :]] = ROCK_EDGE
        for (left, width), colour in ((self.wide_pad, PAD_WIDE), (self.narrow_pad, PAD_NARROW)):
            image[74:76, left : left + width] = colour
        image[:7] = PANEL_DARK
        image[ROAD_Y - 2 : ROAD_Y + 3] = PANEL_TEAL
        image[ROAD_Y + 2, ::4] = HULL_WHITE
        image[ROAD_Y - 3 : ROAD_Y + 4, POD_X - 2 : POD_X + 5] = POD
        return image

    def _frame(self):
        image = self.backdrop.copy()
        fuel = int(50 * self.fuel / TANK)
        image[2:5, 2 : 2 + fuel] = CELL_BLUE
        for life in range(self.lives):
            image[2:5, 62 + 6 * life : 66 + 6 * life] = ALARM_RED
        for x in self.larvae:
            image[ROAD_Y - 1 : ROAD_Y + 2, int(x) : int(x) + 4] = LARVA
        for x, y, reload in self.towers:
            row, column = int(y), int(x)
            image[row - 2 : row + 3, column - 1 : column + 2] = TOWER
            if reload > TOWER_RELOAD - 3:
                image[ROAD_Y + 3 : row - 1, column] = HULL_WHITE
        for x, y in self.cells:
            image[y - 1 : y + 2, x - 1 : x + 2] = CELL_BLUE
            image[y - 4 : y - 1, x] = PANEL_TEAL
        if self.fruit and self.steps % 6 < 4:
            x, y = self.fruit
            image[y - 2 : y + 2, x - 2 : x + 2] = FLAME
        hx, hy = int(self.hunter[0]), int(self.hunter[1])
        image[hy - 2 : hy + 3, hx - 2 : hx + 3] = PANEL_TEAL if self.flee else ALARM_RED
        image[hy - 1, hx - 1] = image[hy - 1, hx + 1] = HULL_WHITE
        self._draw_capsule(image)
        if self.flash:
            image[0, :] = image[-1, :] = ALARM_RED
            image[:, 0] = image[:, -1] = ALARM_RED
        return image

    def _draw_capsule(self, image):
        heading = math.radians(self.angle)
        sine, cosine = math.sin(heading), math.cos(heading)

        def plot(across, along, colour):
            column = int(round(self.x + across * cosine - along * sine))
            row = int(round(self.y + across * sine + along * cosine))
            if 0 <= column < SIZE and 0 <= row < SIZE:
                image[row, column] = colour

        for along in range(-3, 3):
            for across in (-1, 0, 1) if along > -3 else (0,):
                plot(across, along, HULL_WHITE)
        plot(0, -1, PANEL_TEAL)
        if self.legs:
            reach = 3 if self.legs == LEG_STEPS else 2
            plot(-2, reach, POD)
            plot(2, reach, POD)
        if self.burning:
            for along in (3, 4, 5):
                plot(0, along, FLAME)
