"""Moon Quarry: swing a rover from anchor to anchor, carry keys through two doors and switch off four beam emitters.

Seen from above. The rover always circles an anchor (10 degrees a step); up and down change the radius, left and right
the sense. Button one lets go, button two dashes 24 pixels forward, untouchable for four steps. The quarry has three
rooms behind two coloured doors; each room holds one patrolling drone, and rows of eight drones sweep over all of them.
An emitter goes dark when the rover touches it from behind, that is on the side its beam does not point to.
"""

import random
from math import atan2, cos, hypot, pi, radians, sin

import gymnasium as gym
import numpy as np
from gymnasium import spaces

W = 84
TOP = 6
MAX_STEPS = 800
LIVES = 3

ORBIT_RATE = radians(10)
RADIUS_MIN, RADIUS_MAX = 5.0, 16.0
CATCH = 14.0
FLIGHT_SPEED = 2.0
DASH_REACH, DASH_STEPS, DASH_REST = 24.0, 4, 24
ROW_SIZE, ROW_EVERY, ROW_SPEED = 8, 190, 0.8

DOOR_X = (28, 56)
DOOR_OPEN_STEPS = 50
MOST_SHUT = 10

BEAM_GRACE = 2
BEAM_RANGE = 75
HOUSING = 7.0
BEAM_FASTER_EVERY = 250
TOUCH = 5.0

BLACK = (8, 8, 12)
ASH = (92, 92, 98)
ASH_LIGHT = (124, 124, 130)
ICE = (120, 220, 250)
ORANGE = (255, 150, 40)
DRONE = (235, 90, 30)
ROW_DRONE = (250, 190, 60)
DOOR_COLOURS = ((80, 140, 255), (230, 90, 220))
WHITE = (245, 245, 250)
PLANET = (40, 70, 140)
BOULDER = (60, 56, 56)


class GameEnv(gym.Env):
    """Orbit, fly, dash; open doors; disarm beams."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (W, W, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        rng = self.np_random
        jitter = rng.integers(-2, 3, size=(7, 2))
        grid = ((14, 26), (14, 60), (42, 22), (42, 45), (42, 68), (70, 26), (70, 60))
        self.anchors = [(x + int(dx), y + int(dy)) for (x, y), (dx, dy) in zip(grid, jitter)]
        # One emitter on each edge, beside an anchor whose circle passes it: position and inward direction in degrees.
        left, right = self.anchors[1], self.anchors[5]
        self.emitters = [
            {"pos": (4, left[1]), "facing": 0, "on": True},
            {"pos": (self.anchors[2][0], TOP + 5), "facing": 90, "on": True},
            {"pos": (self.anchors[4][0], W - 5), "facing": 270, "on": True},
            {"pos": (W - 5, right[1]), "facing": 180, "on": True},
        ]
        for emitter in self.emitters:
            emitter["swing"] = float(rng.integers(-60, 61))
            emitter["turn"] = 1 if rng.random() < 0.5 else -1
        self.door_keys = {0: (14, 43), 1: (49, 57)}
        self.carried = None
        self.door_timer = [0, 0]
        self.times_shut = 0
        spots = ((20, 40), (36, 33), (50, 32), (64, 43), (77, 44))
        self.boulders = [[x + float(rng.integers(-2, 3)), y + float(rng.integers(-2, 3))] for x, y in spots]
        self.drones = [[x, float(rng.integers(30, 60)), random.choice((-0.5, 0.5))] for x in (22.0, 34.0, 63.0)]
        self.row_y = None
        self.anchor = 0
        self.left_anchor = None
        self.radius = 9.0
        self.angle = float(rng.uniform(0, 2 * pi))
        self.sense = 1
        self.x, self.y = self._orbit_point()
        self.vx, self.vy = 0.0, 0.0
        self.beams = [self._beam_end(emitter) for emitter in self.emitters]
        self.dash = self.rest = 0
        self.in_beam = 0
        self.hurt = 0
        self.lives = LIVES
        self.steps = 0
        self.won = self.lost = False
        return self._draw(), self._info()

    # -- motion ----------------------------------------------------------------

    def _orbit_point(self):
        ax, ay = self.anchors[self.anchor]
        return ax + self.radius * cos(self.angle), ay + self.radius * sin(self.angle)

    def _heading(self):
        """The way the rover faces: along its circle, or along its flight."""
        if self.anchor is None:
            return atan2(self.vy, self.vx)
        return self.angle + self.sense * pi / 2

    def _shut_door_between(self, x0, x1):
        """The door that stops a move from x0 to x1; a matching key opens it and lets the rover pass."""
        for number, door in enumerate(DOOR_X):
            if (x0 - door) * (x1 - door) <= 0 and x0 != x1 and not self.door_timer[number]:
                if self.carried != number:
                    return True
                self.door_timer[number] = DOOR_OPEN_STEPS
        return False

    def _move(self, direction, let_go, dash):
        if self.rest:
            self.rest -= 1
        if dash and not self.rest and not self.dash:
            self._leave_anchor(DASH_REACH / DASH_STEPS)
            self.dash, self.rest = DASH_STEPS, DASH_REST + DASH_STEPS
        elif let_go and self.anchor is not None:
            self._leave_anchor(FLIGHT_SPEED)
        if self.anchor is not None:
            self._circle(direction)
        else:
            self._glide()

    def _leave_anchor(self, speed):
        heading = self._heading()
        self.vx, self.vy = speed * cos(heading), speed * sin(heading)
        if self.anchor is not None:
            self.left_anchor, self.anchor = self.anchor, None

    def _circle(self, direction):
        if direction == 1:
            self.radius = min(RADIUS_MAX, self.radius + 1)
        elif direction == 2:
            self.radius = max(RADIUS_MIN, self.radius - 1)
        elif direction == 3:
            self.sense = -1
        elif direction == 4:
            self.sense = 1
        before = self.angle
        self.angle = (self.angle + self.sense * ORBIT_RATE) % (2 * pi)
        x, y = self._orbit_point()
        outside = not (2 <= x <= W - 3 and TOP + 2 <= y <= W - 3)
        if outside or self._shut_door_between(self.x, x):
            self.sense = -self.sense
            self.angle = before
            if outside:
                self.radius = max(RADIUS_MIN, self.radius - 1)
            return
        self.x, self.y = x, y

    def _glide(self):
        x, y = self.x + self.vx, self.y + self.vy
        if not 2 <= x <= W - 3 or self._shut_door_between(self.x, x):
            self.vx = -self.vx
            x = self.x
        if not TOP + 2 <= y <= W - 3:
            self.vy = -self.vy
            y = self.y
        self.x, self.y = x, y
        if self.dash:
            self.dash -= 1
            if not self.dash:
                heading = self._heading()
                self.vx, self.vy = FLIGHT_SPEED * cos(heading), FLIGHT_SPEED * sin(heading)
            return
        for number, (ax, ay) in enumerate(self.anchors):
            gap = hypot(self.x - ax, self.y - ay)
            if number == self.left_anchor:
                if gap > CATCH + 2:
                    self.left_anchor = None
            elif gap <= CATCH and self._same_room(self.x, ax):
                self.anchor, self.radius = number, max(RADIUS_MIN, gap)
                self.angle = atan2(self.y - ay, self.x - ax)
                turning = (self.x - ax) * self.vy - (self.y - ay) * self.vx
                self.sense = 1 if turning >= 0 else -1
                return

    @staticmethod
    def _same_room(x0, x1):
        return all((x0 - door) * (x1 - door) > 0 for door in DOOR_X)

    # -- the quarry ------------------------------------------------------------

    def step(self, action):
        direction, let_go, dash = int(action[0]), bool(action[1]), bool(action[2])
        reward = -0.002
        if not (self.won or self.lost):
            self.steps += 1
            self.hurt = max(0, self.hurt - 1)
            self._move(direction, let_go, dash)
            self._shove_boulders()
            reward += self._take_keys() + self._run_doors() + self._switch_off()
            self._turn_beams()
            self._move_drones()
            if self._hit() and not self.hurt:
                self.lives -= 1
                self.hurt = 20
                self.in_beam = 0
                reward -= 1.0
            self.won = not any(emitter["on"] for emitter in self.emitters)
            self.lost = not self.won and (self.lives <= 0 or self.times_shut >= MOST_SHUT)
            reward += 5.0 * self.won - 1.0 * self.lost
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._draw(), float(reward), terminated, truncated, self._info()

    def _shove_boulders(self):
        heading = self._heading()
        for boulder in self.boulders:
            if hypot(boulder[0] - self.x, boulder[1] - self.y) < 4:
                boulder[0] = min(max(boulder[0] + 2 * cos(heading), 4.0), W - 5.0)
                boulder[1] = min(max(boulder[1] + 2 * sin(heading), TOP + 4.0), W - 5.0)

    def _take_keys(self):
        for number, (kx, ky) in list(self.door_keys.items()):
            if hypot(kx - self.x, ky - self.y) < TOUCH:
                del self.door_keys[number]
                if self.carried is not None:
                    # A little aside, or the two keys would be swapped again at the next step.
                    self.door_keys[self.carried] = (kx, ky - 12)
                self.carried = number
                return 0.5
        return 0.0

    def _run_doors(self):
        for number in (0, 1):
            if self.door_timer[number]:
                self.door_timer[number] -= 1
                if not self.door_timer[number]:
                    self.times_shut += 1
        return 0.0

    def _beam_angle(self, emitter):
        return radians(emitter["facing"] + emitter["swing"])

    def _switch_off(self):
        for emitter in self.emitters:
            ex, ey = emitter["pos"]
            if emitter["on"] and hypot(ex - self.x, ey - self.y) < TOUCH:
                beam = self._beam_angle(emitter)
                if (self.x - ex) * cos(beam) + (self.y - ey) * sin(beam) < 0:
                    emitter["on"] = False
                    return 1.0
        return 0.0

    def _turn_beams(self):
        pace = 1 + min(3, self.steps // BEAM_FASTER_EVERY)
        for emitter in self.emitters:
            emitter["swing"] += emitter["turn"] * pace
            if abs(emitter["swing"]) >= BEAM_RANGE:
                emitter["turn"] = -1 if emitter["swing"] > 0 else 1
        self.beams = [self._beam_end(emitter) for emitter in self.emitters]

    def _beam_end(self, emitter):
        """How far the beam reaches: to the first boulder, a shut door or the rim."""
        ex, ey = emitter["pos"]
        beam = self._beam_angle(emitter)
        dx, dy = cos(beam), sin(beam)
        reach = 60.0
        for bx, by in self.boulders:
            along = (bx - ex) * dx + (by - ey) * dy
            across = abs((bx - ex) * dy - (by - ey) * dx)
            if along > 0 and across < 3:
                reach = min(reach, along)
        for number, door in enumerate(DOOR_X):
            if not self.door_timer[number] and abs(dx) > 1e-6 and (door - ex) / dx > 0:
                reach = min(reach, (door - ex) / dx)
        return reach, dx, dy

    def _lit(self):
        for emitter, (reach, dx, dy) in zip(self.emitters, self.beams):
            if not emitter["on"]:
                continue
            ex, ey = emitter["pos"]
            along = (self.x - ex) * dx + (self.y - ey) * dy
            across = abs((self.x - ex) * dy - (self.y - ey) * dx)
            if HOUSING < along < reach and across < 1.2:
                return True
        return False

    def _move_drones(self):
        for drone in self.drones:
            drone[1] += drone[2]
            if not TOP + 8 < drone[1] < W - 8 or random.random() < 0.01:
                drone[2] = -drone[2]
                drone[1] += 2 * drone[2]
        if self.row_y is None and self.steps % ROW_EVERY == 0:
            self.row_y = float(TOP)
        elif self.row_y is not None:
            self.row_y += ROW_SPEED
            if self.row_y > W + 2:
                self.row_y = None

    def _hit(self):
        self.in_beam = self.in_beam + 1 if self._lit() else 0
        if self.dash:
            return False
        near = any(hypot(x - self.x, y - self.y) < 3 for x, y, _ in self.drones)
        swept = self.row_y is not None and abs(self.row_y - self.y) < 2
        return near or swept or self.in_beam > BEAM_GRACE

    def _info(self):
        dark = sum(not emitter["on"] for emitter in self.emitters)
        return {"is_success": self.won, "lives": self.lives, "emitters_dark": dark, "doors_shut": self.times_shut}

    # -- drawing ---------------------------------------------------------------

    def render(self):
        return self._draw()

    def _draw(self):
        frame = np.empty((W, W, 3), np.uint8)
        frame[:] = ASH
        frame[::9, ::7] = ASH_LIGHT
        frame[4::11, 3::13] = ASH_LIGHT
        frame[:TOP] = BLACK
        frame[0:4, 66:80] = PLANET
        for number, door in enumerate(DOOR_X):
            if self.door_timer[number]:
                frame[TOP::6, door] = DOOR_COLOURS[number]
            else:
                frame[TOP:, door - 1 : door + 1] = DOOR_COLOURS[number]
        for x, y in self.anchors:
            frame[y - 1 : y + 2, x - 1 : x + 2] = BLACK
            frame[y, x] = ICE
        for bx, by in self.boulders:
            self._block(frame, bx, by, 2, BOULDER)
        for number, (kx, ky) in self.door_keys.items():
            self._block(frame, kx, ky, 1, DOOR_COLOURS[number])
            frame[ky, kx + 1 : kx + 5] = DOOR_COLOURS[number]
        for emitter, beam in zip(self.emitters, self.beams):
            self._draw_emitter(frame, emitter, beam)
        for x, y, _ in self.drones:
            self._block(frame, x, y, 1, DRONE)
        if self.row_y is not None:
            for place in range(ROW_SIZE):
                self._block(frame, 5 + place * 10.5, self.row_y, 1, ROW_DRONE)
                self._block(frame, 10 + place * 10.5, self.row_y, 0, ROW_DRONE)
        self._draw_rover(frame)
        self._draw_counts(frame)
        return frame

    @staticmethod
    def _block(frame, x, y, half, colour):
        row, column = int(y), int(x)
        frame[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1] = colour

    def _draw_emitter(self, frame, emitter, beam):
        ex, ey = emitter["pos"]
        self._block(frame, ex, ey, 2, ORANGE if emitter["on"] else BLACK)
        if not emitter["on"]:
            return
        reach, dx, dy = beam
        along = np.arange(2, reach)
        columns = (ex + along * dx).astype(int)
        rows = (ey + along * dy).astype(int)
        inside = (columns >= 0) & (columns < W) & (rows >= TOP) & (rows < W)
        frame[rows[inside], columns[inside]] = ORANGE

    def _draw_rover(self, frame):
        colour = WHITE if self.dash or self.hurt % 4 < 2 else DRONE
        self._block(frame, self.x, self.y, 1, colour)
        heading = self._heading()
        self._block(frame, self.x + 2 * cos(heading), self.y + 2 * sin(heading), 0, ICE)
        if self.carried is not None:
            self._block(frame, self.x, self.y, 0, DOOR_COLOURS[self.carried])

    def _draw_counts(self, frame):
        for life in range(self.lives):
            frame[1:4, 2 + 4 * life : 5 + 4 * life] = ICE
        frame[1:3, 18 : 18 + (DASH_REST + DASH_STEPS - self.rest) // 2] = WHITE
        frame[3:5, 18 : 18 + 3 * self.times_shut] = ORANGE
        for number, emitter in enumerate(self.emitters):
            frame[1:4, 50 + 4 * number : 53 + 4 * number] = ORANGE if emitter["on"] else ASH
