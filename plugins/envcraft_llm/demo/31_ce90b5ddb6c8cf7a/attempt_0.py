"""Lighthouse Coast: shove buoys onto their moorings while reef crabs bounce about the bay.

A rowing boat moves from cell to cell. It can shove single buoys, pick up lanterns (each makes it slower) and bring them
to the jetty, and drop bait, which draws crabs away or into pens. A buoy that is shoved against a crab splits it; the
halves are faster, and grow together again when they are left in peace.
"""

import math

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL, COLS, ROWS, TOP = 7, 12, 11, 7
MAX_STEPS, LIVES, GRACE = 950, 2, 45

MARKS, SPARE = 3, 3
ROW_TIME = 2.0  # steps for a cell, unladen
SLOWER, MOST_CARRIED = 0.2, 5
UNLOAD_TIME, LANTERNS, CRUMBLE_TIME = 7, 14, 100

BAITS, SMELL, MEAL, PENS = 8, 30, 20, 3
CRABS, CRAB_SPEED, FASTER = 3, 0.45, 1.3
MERGE_TIME, CROWD = 80, 14

NOOP, NORTH, SOUTH, WEST, EAST = range(5)
VECTOR = {NORTH: (0, -1), SOUTH: (0, 1), WEST: (-1, 0), EAST: (1, 0)}

COLOURS = {
    "water": (40, 48, 76),
    "swell": (52, 62, 94),
    "beam": (78, 82, 96),
    "strip": (22, 22, 34),
    "mooring": (214, 206, 230),
    "buoy": (244, 124, 60),
    "buoy_home": (120, 220, 130),
    "stripe": (240, 240, 240),
    "lantern": (255, 232, 120),
    "jetty": (122, 88, 64),
    "pen": (126, 84, 160),
    "bait": (250, 170, 180),
    "crab": (226, 60, 90),
    "crab_small": (255, 130, 150),
    "boat": (176, 126, 82),
    "oars": (236, 236, 240),
}


class Crab:
    """A crab anywhere on the water; `big` ones split."""

    __slots__ = ("x", "y", "vx", "vy", "big", "peace", "eating")

    def __init__(self, x, y, vx, vy, big):
        self.x, self.y, self.vx, self.vy, self.big = x, y, vx, vy, big
        self.peace = self.eating = 0


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 24}

    def __init__(self, render_mode="rgb_array"):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ---------------------------------------------------------------- bay

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps, self.lives, self.grace = 0, LIVES, GRACE
        self.rest = 0.0
        self.carried = self.delivered = self.unloading = self.penned = 0
        self.baits_left, self.baits = BAITS, []  # [x, y, steps of meal left] in cells
        self.facing = EAST
        self.button_down = False
        self.won = self.lost = False
        while not self._moor():
            pass
        self._scatter()
        self.best = self.filled()
        self.water = self._paint_water()
        return self.render(), self._info()

    def _moor(self):
        """Put buoys on the moorings and drag them off, each by a boat that could have got there."""
        inner = [(x, y) for x in range(2, COLS - 2) for y in range(2, ROWS - 2)]
        picked = [inner[i] for i in self.np_random.permutation(len(inner))]
        self.marks = picked[:MARKS]
        self.buoys = list(picked[: MARKS + SPARE])
        self.boat = picked[-1]
        for number in range(MARKS):
            for _ in range(5):
                way = VECTOR[int(self.np_random.integers(1, 5))]
                for _ in range(int(self.np_random.integers(1, 4))):
                    x, y = self.buoys[number]
                    ahead, beyond = (x + way[0], y + way[1]), (x + 2 * way[0], y + 2 * way[1])
                    if not (self.open(ahead) and self.open(beyond)):
                        break
                    self.buoys[number] = ahead
                    self.boat = beyond
        away = [min(abs(x - a) + abs(y - b) for a, b in self.marks) for x, y in self.buoys]
        return self.filled() == 0 and min(away) >= 2 and sum(away[:MARKS]) >= 11 and self.boat not in self.buoys

    def _scatter(self):
        edge = [(0, y) for y in range(2, ROWS - 2)] + [(COLS - 1, y) for y in range(2, ROWS - 2)]
        picked = [edge[i] for i in self.np_random.permutation(len(edge))]
        self.jetty, self.pens = picked[0], picked[1 : 1 + PENS]
        taken = {*self.buoys, *self.marks, self.boat, self.jetty, *self.pens}
        free = [(x, y) for x in range(COLS) for y in range(ROWS) if (x, y) not in taken]
        self.lanterns = [free[i] for i in self.np_random.permutation(len(free))[:LANTERNS]]
        self.crabs = []
        bx, by = self.middle(self.boat)
        while len(self.crabs) < CRABS:
            x, y = float(self.np_random.uniform(6, 78)), float(self.np_random.uniform(TOP + 6, 78))
            angle = float(self.np_random.uniform(0.3, 1.2)) + math.pi / 2 * int(self.np_random.integers(4))
            if math.hypot(x - bx, y - by) > 28:
                self.crabs.append(Crab(x, y, CRAB_SPEED * math.cos(angle), CRAB_SPEED * math.sin(angle), True))

    def open(self, cell):
        """Whether a cell is on the board and holds no buoy."""
        return 0 <= cell[0] < COLS and 0 <= cell[1] < ROWS and cell not in self.buoys

    def middle(self, cell):
        return cell[0] * CELL + 3.0, TOP + cell[1] * CELL + 3.0

    def filled(self):
        return sum(mark in self.buoys for mark in self.marks)

    # ---------------------------------------------------------------- step

    def step(self, action):
        move, drop = int(action[0]), bool(action[1])
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        self.grace = max(0, self.grace - 1)
        reward = -0.001
        self.rest = max(0.0, self.rest - 1.0)
        if move != NOOP and self.rest < 1.0:
            reward += self._row(move)
        if drop and not self.button_down and self.baits_left:
            self.baits_left -= 1
            self.baits.append([*self.boat, MEAL])
        self.button_down = drop
        reward += self._lanterns()
        reward += self._swim()
        self._merge()
        if self.filled() > self.best:
            self.best = self.filled()
            reward += 1.0
        if self.filled() == MARKS:
            self.won = True
            reward += 4.0
        elif self.lives <= 0 or len(self.crabs) >= CROWD:
            self.lost = True
        terminated = self.won or self.lost
        return self.render(), reward, terminated, self.steps >= MAX_STEPS and not terminated, self._info()

    def _row(self, move):
        self.facing = move
        dx, dy = VECTOR[move]
        cell = (self.boat[0] + dx, self.boat[1] + dy)
        reward = 0.0
        if cell in self.buoys:
            beyond = (cell[0] + dx, cell[1] + dy)
            if not self.open(beyond):
                return 0.0
            self.buoys[self.buoys.index(cell)] = beyond
            reward += self._harm(beyond)
        elif not self.open(cell):
            return 0.0
        self.boat = cell
        self.rest += ROW_TIME * (1.0 + SLOWER * self.carried)
        return reward

    def _harm(self, cell):
        """A buoy has been shoved into a cell: what swims there is split, or gone."""
        x, y = self.middle(cell)
        reward = 0.0
        for crab in list(self.crabs):
            if abs(crab.x - x) < 6 and abs(crab.y - y) < 6:
                self.crabs.remove(crab)
                reward += 0.2
                if crab.big:
                    for sign in (1, -1):
                        vx, vy = -sign * crab.vy * FASTER, sign * crab.vx * FASTER
                        self.crabs.append(Crab(crab.x + 4 * vx, crab.y + 4 * vy, vx, vy, False))
        return reward

    def _lanterns(self):
        reward = 0.0
        if self.boat in self.lanterns and self.carried < MOST_CARRIED:
            self.lanterns.remove(self.boat)
            self.carried += 1
            reward += 0.05
        if self.boat == self.jetty and self.carried:
            self.unloading += 1
            if self.unloading >= UNLOAD_TIME:
                self.unloading = 0
                self.carried -= 1
                self.delivered += 1
                reward += 0.3
        else:
            self.unloading = 0
        if self.steps % CRUMBLE_TIME == 0:
            if self.lanterns:
                self.lanterns.pop(int(self.np_random.integers(len(self.lanterns))))
            elif self.carried:
                self.carried -= 1
        return reward

    def _swim(self):
        reward = 0.0
        bx, by = self.middle(self.boat)
        for crab in list(self.crabs):
            crab.peace += 1
            bait = self._smelt(crab)
            if bait is None:
                self._bounce(crab)
            elif self._feed(crab, bait):
                self.crabs.remove(crab)
                self.penned += 1
                reward += 0.5
                continue
            near = 5.5 if crab.big else 4.5
            if not self.grace and abs(crab.x - bx) < near and abs(crab.y - by) < near:
                self.lives -= 1
                self.grace = GRACE
                reward -= 1.0
        self.baits = [bait for bait in self.baits if bait[2] > 0]
        return reward

    def _smelt(self, crab):
        """The nearest bait that a crab can smell."""
        best, reach = None, SMELL
        for bait in self.baits:
            x, y = self.middle(bait)
            distance = math.hypot(x - crab.x, y - crab.y)
            if distance <= reach:
                best, reach = bait, distance
        return best

    def _feed(self, crab, bait):
        """Swim to the bait and eat; True when the crab is locked into a pen."""
        x, y = self.middle(bait)
        dx, dy = x - crab.x, y - crab.y
        distance = math.hypot(dx, dy)
        if distance > 1.5:
            pace = CRAB_SPEED * (1.0 if crab.big else FASTER)
            crab.x += pace * dx / distance
            crab.y += pace * dy / distance
            return False
        bait[2] -= 1
        return bait[2] <= 0 and (bait[0], bait[1]) in self.pens

    def _bounce(self, crab):
        for axis in ("x", "y"):
            speed = getattr(crab, "v" + axis)
            here = getattr(crab, axis) + speed
            low, high = (3, 80) if axis == "x" else (TOP + 3, 80)
            x, y = (here, crab.y) if axis == "x" else (crab.x, here)
            blocked = (int(x) // CELL, (int(y) - TOP) // CELL) in self.buoys
            if not low <= here <= high or blocked:
                setattr(crab, "v" + axis, -speed)
                here = min(max(getattr(crab, axis), low), high)
            setattr(crab, axis, here)

    def _merge(self):
        small = [crab for crab in self.crabs if not crab.big and crab.peace >= MERGE_TIME]
        if len(small) >= 2:
            one, other = small[:2]
            self.crabs.remove(other)
            one.big, one.peace = True, 0
            one.vx, one.vy = one.vx / FASTER, one.vy / FASTER

    def _info(self):
        return {
            "is_success": self.won,
            "filled": self.filled(),
            "lives": self.lives,
            "delivered": self.delivered,
            "penned": self.penned,
            "crabs": len(self.crabs),
        }

    # ---------------------------------------------------------------- picture

    def _paint_water(self):
        water = np.empty((84, 84, 3), np.uint8)
        water[:] = COLOURS["water"]
        for y in range(TOP + 2, 84, 5):
            for x in range((y * 7) % 11, 80, 16):
                water[y, x : x + 5] = COLOURS["swell"]
        for cell in self.marks:
            x, y = cell[0] * CELL, TOP + cell[1] * CELL
            water[y : y + CELL, x : x + CELL] = COLOURS["mooring"]
            water[y + 1 : y + CELL - 1, x + 1 : x + CELL - 1] = COLOURS["water"]
            water[y + 3, x + 3] = COLOURS["mooring"]
        for cell in self.pens:
            x, y = cell[0] * CELL, TOP + cell[1] * CELL
            water[y : y + CELL : 2, x : x + CELL] = COLOURS["pen"]
        x, y = self.jetty[0] * CELL, TOP + self.jetty[1] * CELL
        water[y : y + CELL, x : x + CELL] = COLOURS["jetty"]
        water[y + 3, x : x + CELL] = COLOURS["strip"]
        return water

    def render(self):
        frame = self.water.copy()
        # The beam of the lighthouse sweeps the bay: a pale column that wanders to and fro.
        beam = abs(self.steps % 168 - 84)
        column = frame[TOP:, max(0, beam - 3) : beam + 3]
        column[(column == COLOURS["water"]).all(axis=-1)] = COLOURS["beam"]
        for cell in self.lanterns:
            self._block(frame, self.middle(cell), 1, 1, COLOURS["lantern"])
        for x, y, meal in self.baits:
            self._block(frame, self.middle((x, y)), 1 + (meal > MEAL // 2), 1, COLOURS["bait"])
        for cell in self.buoys:
            home = cell in self.marks
            self._block(frame, self.middle(cell), 2, 3, COLOURS["buoy_home" if home else "buoy"])
            self._block(frame, self.middle(cell), 2, 0, COLOURS["stripe"])
        x, y = self.middle(self.boat)
        if self.grace % 6 < 4:
            wide, high = (3, 1) if self.facing in (EAST, WEST) else (1, 3)
            self._block(frame, (x, y), high + 1, wide + 1 - high, COLOURS["oars"])
            self._block(frame, (x, y), wide, high, COLOURS["boat"])
        for crab in self.crabs:
            size = 3 if crab.big else 2
            self._block(frame, (crab.x, crab.y), size, size - 1, COLOURS["crab" if crab.big else "crab_small"])
            self._block(frame, (crab.x, crab.y - size), 1, 0, COLOURS["strip"])
        frame[:TOP] = COLOURS["strip"]
        for k in range(MARKS):
            frame[1:6, 2 + 6 * k : 7 + 6 * k] = COLOURS["buoy_home" if k < self.filled() else "beam"]
        for k in range(self.carried):
            frame[2:5, 24 + 4 * k : 27 + 4 * k] = COLOURS["lantern"]
        for k in range(self.baits_left):
            frame[3:5, 46 + 3 * k : 48 + 3 * k] = COLOURS["bait"]
        for k in range(self.lives):
            frame[1:6, 78 - 6 * k : 82 - 6 * k] = COLOURS["boat"]
        return frame

    @staticmethod
    def _block(frame, middle, half_width, half_height, colour):
        x, y = int(middle[0]), int(middle[1])
        frame[max(0, y - half_height) : max(0, y + half_height + 1), max(0, x - half_width) : x + half_width + 1] = colour
