"""Lighthouse Coast: a rowing boat holds off a formation of reef crabs below a lighthouse, to the beat of its lamp.

Shoot down all twenty crabs of the formation before they come down to the buoys. Hopping crabs cross the lower water on
the beat, divers drop out of the formation, and unarmed ferries have to be nudged, a quarter turn at each touch, out
through the gate in the upper edge. What is gained within three steps of a flash counts twice.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

WIDTH = HEIGHT = 84
MAX_STEPS = 800
LIVES = 3

BOAT_Y, BOAT_SPEED, BOAT_HALF = 77, 1.5, 4
SHOT_SPEED, SHOTS_IN_AIR = 3.0, 3
RELOAD = 9

ROWS, COLUMNS = 4, 5
PITCH_X, PITCH_Y = 10, 8
FORMATION_TOP = 10
DROP = 3
COVER_Y = 64
MARCH_SLOWEST, MARCH_FASTEST = 0.22, 0.95
SPIT_CHANCE = 0.045
SPIT_SPEED = 1.2
DIVE_EVERY = 95
DIVE_SPEED = 0.9

BEAT, WINDOW, HOP = 14, 3, 12
HOPPER_EVERY = 9  # beats

FERRY_GAP, FERRY_SPEED, FERRY_Y = 40, 1.0, 71
GATE = (34, 50)
HEADINGS = [(1, 0), (0, 1), (-1, 0), (0, -1)]  # each touch turns a ferry to the next one but one clockwise

GRACE = 20

SLATE = (44, 52, 70)
SLATE_DARK = (36, 42, 58)
DUSK = (112, 78, 140)
CRAB_TONES = [(226, 96, 86), (216, 120, 84), (200, 84, 110), (184, 92, 140)]
HOPPER = (170, 60, 200)
LAMP = (255, 224, 110)
FOAM = (232, 240, 244)
BUOY = (240, 150, 50)
BOAT = (168, 116, 70)
FERRY = (120, 220, 190)
SPIT = (255, 120, 160)

CRAB_ART = np.array([[c == "x" for c in row] for row in ("x.....x", "xx.x.xx", ".xxxxx.", "xxxxxxx", "x.x.x.x")])
BOAT_ART = np.array([[c == "x" for c in row] for row in ("....x....", "...xxx...", "xxxxxxxxx", ".xxxxxxx.", "..xxxxx..")])


class GameEnv(gym.Env):
    """One screen, one formation, one lamp that keeps time."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ----------------------------------------------------------------- gymnasium

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.tick = 0
        self.boat_x = 42.0
        self.lives = LIVES
        self.grace = GRACE
        self.reload = 0
        self.over = self.victory = False
        self.passed = 0
        self.alive = np.ones((ROWS, COLUMNS), dtype=bool)
        self.offset_x = float(self.np_random.uniform(8, 30))
        self.offset_y = float(FORMATION_TOP)
        self.heading = 1 if self.np_random.random() < 0.5 else -1
        self.shots = []  # [x, y]
        self.spits = []  # [x, y]
        self.divers = []  # [x, y, phase]
        self.hoppers = []  # [x, direction]
        self.ferries = []  # [x, y, heading, touching]
        self.buoys = [[14, 5], [42, 5], [70, 5]]  # centre x, strength
        self.sea = self._paint_sea()
        return self.render(), self._info()

    def step(self, action):
        move, fire, _ = (int(a) for a in action)
        if self.over:
            return self.render(), 0.0, True, False, self._info()
        self.tick += 1
        self.grace = max(0, self.grace - 1)
        self.reload = max(0, self.reload - 1)
        gain, loss = 0.0, 0
        self._row(move, fire)
        gain += self._fly_shots()
        self._march()
        loss += self._spit_and_dive()
        loss += self._hop()
        ferry_gain, ferry_loss = self._ferry()
        gain += ferry_gain
        loss += ferry_loss
        reward = gain * (2.0 if self._on_beat() else 1.0)
        if loss and not self.grace:
            self.lives -= 1
            self.grace = GRACE
            reward -= 1.0
        if not self.alive.any() and not self.divers:
            self.victory = self.over = True
            reward += 5.0
        elif self.lives <= 0 or self._lowest() >= COVER_Y:
            self.over = True
            reward -= 2.0
        truncated = self.tick >= MAX_STEPS and not self.over
        return self.render(), reward, self.over, truncated, self._info()

    def _info(self):
        return {"is_success": self.victory, "crabs": int(self.alive.sum()), "lives": self.lives, "ferries": self.passed}

    # ----------------------------------------------------------------- rules

    def _on_beat(self):
        phase = self.tick % BEAT
        return min(phase, BEAT - phase) <= WINDOW

    def _crab_centre(self, row, column):
        return self.offset_x + PITCH_X * column, self.offset_y + PITCH_Y * row

    def _lowest(self):
        rows = np.flatnonzero(self.alive.any(axis=1))
        return self.offset_y + PITCH_Y * rows[-1] if rows.size else 0.0

    def _row(self, move, fire):
        if move == 3:
            self.boat_x -= BOAT_SPEED
        elif move == 4:
            self.boat_x += BOAT_SPEED
        self.boat_x = min(max(self.boat_x, BOAT_HALF), WIDTH - 1 - BOAT_HALF)
        if fire and self.reload == 0 and len(self.shots) < SHOTS_IN_AIR:
            self.shots.append([self.boat_x, BOAT_Y - 3.0])
            self.reload = RELOAD

    def _fly_shots(self):
        gain, flying = 0.0, []
        for shot in self.shots:
            shot[1] -= SHOT_SPEED
            hit = self._strike(shot)
            gain += hit
            if not hit and shot[1] > 5 and not self._hits_buoy(shot[0], shot[1]):
                flying.append(shot)
        self.shots = flying
        return gain

    def _strike(self, shot):
        """The reward for what a shot hits, or nothing."""
        x, y = shot
        column = round((x - self.offset_x) / PITCH_X)
        row = round((y - self.offset_y) / PITCH_Y)
        if 0 <= row < ROWS and 0 <= column < COLUMNS and self.alive[row, column]:
            cx, cy = self._crab_centre(row, column)
            if abs(cx - x) <= 3 and abs(cy - y) <= 3:
                self.alive[row, column] = False
                return 0.5
        for diver in self.divers:
            if abs(diver[0] - x) <= 4 and abs(diver[1] - y) <= 4:
                self.divers.remove(diver)
                return 0.75
        for hopper in self.hoppers:
            if abs(hopper[0] - x) <= 4 and y >= FERRY_Y - 4:
                self.hoppers.remove(hopper)
                return 0.25
        return 0.0

    def _hits_buoy(self, x, y):
        for buoy in self.buoys:
            if buoy[1] > 0 and abs(buoy[0] - x) <= 3 and abs(y - COVER_Y) <= 3:
                buoy[1] -= 1
                return True
        return False

    def _march(self):
        left = int(self.alive.sum())
        if not left:
            return
        speed = MARCH_SLOWEST + (MARCH_FASTEST - MARCH_SLOWEST) * (1 - left / (ROWS * COLUMNS)) ** 2
        columns = np.flatnonzero(self.alive.any(axis=0))
        first = self.offset_x + PITCH_X * columns[0]
        last = self.offset_x + PITCH_X * columns[-1]
        self.offset_x += self.heading * speed
        if (self.heading > 0 and last + speed > WIDTH - 5) or (self.heading < 0 and first - speed < 4):
            self.heading = -self.heading
            self.offset_y += DROP

    def _spit_and_dive(self):
        places = np.argwhere(self.alive)
        if len(places) and self.np_random.random() < SPIT_CHANCE:
            if self.np_random.random() < 0.5:  # half of the shots come from right above the boat
                nearest = np.argmin(np.abs(self.offset_x + PITCH_X * places[:, 1] - self.boat_x))
                row, column = places[int(nearest)]
            else:
                row, column = places[int(self.np_random.integers(len(places)))]
            self.spits.append(list(self._crab_centre(row, column)))
        if len(places) > 1 and self.tick % DIVE_EVERY == 0:
            row, column = places[int(self.np_random.integers(len(places)))]
            self.alive[row, column] = False
            self.divers.append([*self._crab_centre(row, column), 0])
        hits = 0
        for spit in list(self.spits):
            spit[1] += SPIT_SPEED
            if self._hits_buoy(spit[0], spit[1]) or spit[1] > HEIGHT:
                self.spits.remove(spit)
            elif abs(spit[0] - self.boat_x) <= BOAT_HALF and abs(spit[1] - BOAT_Y) <= 2:
                self.spits.remove(spit)
                hits += 1
        for diver in self.divers:
            diver[2] += 1
            diver[1] += DIVE_SPEED
            diver[0] += 0.5 * np.sign(self.boat_x - diver[0]) * (diver[1] < 62)
            if abs(diver[0] - self.boat_x) <= 6 and abs(diver[1] - BOAT_Y) <= 4:
                hits += 1
            if diver[1] > HEIGHT + 3:
                diver[1] = 4.0  # a diver that misses comes round from above
        return hits

    def _hop(self):
        if self.tick % BEAT == 0:
            for hopper in self.hoppers:
                hopper[0] += HOP * hopper[1]
            self.hoppers = [h for h in self.hoppers if 0 <= h[0] < WIDTH]
            if (self.tick // BEAT) % HOPPER_EVERY == HOPPER_EVERY - 1:
                from_left = self.np_random.random() < 0.5
                self.hoppers.append([2.0, 1] if from_left else [WIDTH - 3.0, -1])
        return sum(abs(h[0] - self.boat_x) <= 6 for h in self.hoppers)

    def _ferry(self):
        if self.tick % FERRY_GAP == 0:
            if self.np_random.random() < 0.5:
                self.ferries.append([0.0, float(FERRY_Y), 0, False])
            else:
                self.ferries.append([WIDTH - 1.0, float(FERRY_Y), 2, False])
        gain, loss, staying = 0.0, 0, []
        for ferry in self.ferries:
            dx, dy = HEADINGS[ferry[2]]
            ferry[0] += FERRY_SPEED * dx
            ferry[1] += FERRY_SPEED * dy
            touching = abs(ferry[0] - self.boat_x) <= 5 and abs(ferry[1] - BOAT_Y) <= 6
            if touching and not ferry[3]:
                ferry[2] = 3 if ferry[2] in (0, 2) else (ferry[2] + 1) % 4
            ferry[3] = touching
            if ferry[1] < 6 and GATE[0] <= ferry[0] <= GATE[1]:
                self.passed += 1
                gain += 1.0
            elif 0 <= ferry[0] < WIDTH and 6 <= ferry[1] < HEIGHT:
                staying.append(ferry)
        for i, one in enumerate(staying):
            for other in staying[i + 1 :]:
                if abs(one[0] - other[0]) <= 4 and abs(one[1] - other[1]) <= 4:
                    loss += 1
                    staying = [f for f in staying if f is not one and f is not other]
        self.ferries = staying
        return gain, loss

    # ----------------------------------------------------------------- picture

    def _paint_sea(self):
        sea = np.empty((HEIGHT, WIDTH, 3), dtype=np.uint8)
        sea[:] = SLATE
        sea[:6] = DUSK
        for y in range(9, HEIGHT, 6):
            start = int(self.np_random.integers(12))
            for x in range(start, WIDTH - 3, 13):
                sea[y, x : x + 4] = SLATE_DARK
        sea[:6, GATE[0] : GATE[1] + 1] = SLATE
        sea[:6, [GATE[0] - 1, GATE[1] + 1]] = FOAM
        return sea

    def render(self):
        frame = self.sea.copy()
        for row, column in np.argwhere(self.alive):
            x, y = self._crab_centre(row, column)
            self._stamp(frame, CRAB_ART, x, y, CRAB_TONES[row])
        for x, y, _ in self.divers:
            self._stamp(frame, CRAB_ART[::-1], x, y, (255, 60, 60))
        for x, _ in self.hoppers:
            self._stamp(frame, CRAB_ART, x, BOAT_Y - 1, HOPPER)
        for x, strength in self.buoys:
            frame[COVER_Y - 2 : COVER_Y + 3, x - 3 : x - 3 + strength + 2] = BUOY if strength > 0 else SLATE
        for x, y, heading, _ in self.ferries:
            half_w, half_h = (3, 1) if heading % 2 == 0 else (1, 3)
            self._box(frame, x, y, half_w, half_h, FERRY)
        for x, y in self.shots:
            self._box(frame, x, y, 0, 1, LAMP)
        for x, y in self.spits:
            self._box(frame, x, y, 0, 1, SPIT)
        if self.grace % 4 < 2:
            self._stamp(frame, BOAT_ART, self.boat_x, BOAT_Y, BOAT)
            self._box(frame, self.boat_x, BOAT_Y - 2, 0, 0, FOAM)
        if self._on_beat():
            glow = LAMP if self.tick % BEAT == 0 else (170, 150, 90)
            frame[-1] = glow
            frame[:, [0, -1]] = glow
        for k in range(self.lives):
            frame[1:4, 3 + 6 * k : 7 + 6 * k] = FOAM
        frame[2, WIDTH - 2 - 2 * min(self.passed, 12) : WIDTH - 2] = FERRY
        return frame

    def _stamp(self, frame, art, x, y, colour):
        height, width = art.shape
        left, top = round(x) - width // 2, round(y) - height // 2
        x0, y0 = max(left, 0), max(top, 0)
        x1, y1 = min(left + width, WIDTH), min(top + height, HEIGHT)
        if x0 < x1 and y0 < y1:
            frame[y0:y1, x0:x1][art[y0 - top : y1 - top, x0 - left : x1 - left]] = colour

    def _box(self, frame, x, y, half_w, half_h, colour):
        x, y = round(x), round(y)
        frame[max(0, y - half_h) : max(0, y + half_h + 1), max(0, x - half_w) : max(0, x + half_w + 1)] = colour
