"""Dream Bedroom: bring a sleepwalker and its mirrored twin into bed at the same time.

Up and down move both alike, left and right are reversed for the twin; pillows stop either body alone. The lamp that the
sleepwalker carries burns down, oil lamps feed it. Feathers and nightmares drift through the room, the first button is
a magnet for both, and two pairs of portals shift whatever enters them.
"""

import math
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 6
COLS, ROWS = 14, 13
TOP = 6
MAX_STEPS = 950
LIVES = 4

MOVE_REST = 3  # a sleepwalker is slow: steps from one move to the next
PILLOWS = 16
PITS = 3
MAGNET_REACH = 18
MAGNET_PULL = 1.0
LAMP_WIDE = 30
LAMP_BURN = 18
LAMP_LEAST = 7
OIL_LAMPS = 5
OIL = 6
PAIRS = 2
PORTAL_REST = 15
PORTAL_MOVE = 100
STRAYED_LIMIT = 6
DRIFT_GAP = 22
DRIFT_SPEED = 0.5

INDIGO = np.array([34, 28, 84], np.uint8)
INDIGO_LIGHT = np.array([44, 38, 102], np.uint8)
VOID = np.array([8, 6, 24], np.uint8)
LAVENDER = (178, 150, 230)
STAR = (250, 250, 255)
QUILT = (255, 140, 190)
QUILT_DARK = (200, 80, 140)
PIT = (0, 0, 0)
OIL_GOLD = (255, 210, 90)
OIL_FAINT = (90, 72, 40)
NIGHTMARE = (200, 30, 60)
PORTAL_TONES = [(60, 220, 220), (250, 170, 60)]

MOVES = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
PIXEL = np.arange(84)
FLOOR = np.where(((PIXEL[:, None] // CELL + PIXEL // CELL) % 2 == 0)[..., None], INDIGO_LIGHT, INDIGO)


@dataclass
class Drifter:
    """A feather, or a nightmare."""

    x: float
    y: float
    vx: float
    vy: float
    nightmare: bool
    rest: int = 0
    strayed: bool = False


def centre(cell):
    """The middle of a cell in pixels."""
    return cell[0] * CELL + 2.5, TOP + cell[1] * CELL + 2.5


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(low=0, high=255, shape=(84, 84, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ the room

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.light = LAMP_WIDE
        self.strayed = 0
        self.feathers = 0
        self.won = False
        self.lost = False
        self.magnet = False
        self.rest = 0
        self.drifters = []
        while not self._furnish():
            pass
        self.walker, self.twin = self.start
        self.portal_rest = [0] * PAIRS
        return self.render(), self._info()

    def _furnish(self):
        """Lay out the room; the bed goes where a long random walk of both bodies ends side by side."""
        cells = [(x, y) for x in range(COLS) for y in range(ROWS)]
        order = [cells[i] for i in self.np_random.permutation(len(cells))]
        row = int(self.np_random.integers(3, 10))
        self.start = ((1, row), (11, row))
        order = [c for c in order if c not in self.start]
        self.pillows = set(order[:PILLOWS])
        self.pits = set(order[PILLOWS : PILLOWS + PITS])
        rest = order[PILLOWS + PITS :]
        self.portals = [[rest[2 * k], rest[2 * k + 1]] for k in range(PAIRS)]
        self.lamps = rest[2 * PAIRS : 2 * PAIRS + OIL_LAMPS]
        shut = self.pits | {cell for pair in self.portals for cell in pair}
        a, b = self.start
        for number, move in enumerate(self.np_random.integers(1, 5, size=4000).tolist()):
            next_a, next_b = self._moved(a, b, move)
            if next_a in shut or next_b in shut:
                continue
            a, b = next_a, next_b
            side_by_side = a[1] == b[1] and abs(a[0] - b[0]) == 1
            remote = abs(a[0] - 6.5) > 2.5 and abs(a[1] - row) > 2
            if number > 80 and side_by_side and remote and a not in self.lamps and b not in self.lamps:
                self.bed = (a, b)
                return True
        return False

    def _moved(self, a, b, move):
        """Where both bodies are after a move: each is stopped by pillows and by the edge of the floor."""
        dx, dy = MOVES[move]
        found = []
        for (x, y), way in ((a, dx), (b, -dx)):
            cell = (x + way, y + dy)
            free = 0 <= cell[0] < COLS and 0 <= cell[1] < ROWS and cell not in self.pillows
            found.append(cell if free else (x, y))
        return found[0], found[1]

    # ------------------------------------------------------------------ the rules

    def step(self, action):
        move, magnet, _ = (int(v) for v in action)
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        self.magnet = bool(magnet)
        reward = -0.001
        self.rest = max(0, self.rest - 1)
        if move and not self.rest:
            self.rest = MOVE_REST
            self.walker, self.twin = self._moved(self.walker, self.twin, move)
            self._teleport_bodies()
            reward += self._fall()
        reward += self._burn()
        self._shift_portals()
        reward += self._drift()
        if {self.walker, self.twin} == set(self.bed):
            self.won = True
            reward += 5.0
        elif self.lives <= 0 or self.strayed >= STRAYED_LIMIT:
            self.lost = True
            reward -= 1.0
        terminated = self.won or self.lost
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.render(), float(reward), terminated, truncated, self._info()

    def _teleport_bodies(self):
        for number, (one, other) in enumerate(self.portals):
            if self.portal_rest[number]:
                continue
            for name in ("walker", "twin"):
                cell = getattr(self, name)
                if cell in (one, other):
                    setattr(self, name, other if cell == one else one)
                    self.portal_rest[number] = PORTAL_REST
                    break

    def _fall(self):
        if self.walker in self.pits or self.twin in self.pits:
            self.walker, self.twin = self.start
            self.lives -= 1
            return -0.5
        return 0.0

    def _burn(self):
        if self.steps % LAMP_BURN == 0:
            self.light = max(LAMP_LEAST, self.light - 1)
        if self.walker in self.lamps:
            self.lamps = [lamp for lamp in self.lamps if lamp != self.walker]
            self.light += OIL
            return 0.2
        return 0.0

    def _shift_portals(self):
        self.portal_rest = [max(0, rest - 1) for rest in self.portal_rest]
        if self.steps % PORTAL_MOVE:
            return
        taken = self.pillows | self.pits | set(self.bed) | set(self.start) | {self.walker, self.twin}
        taken |= {cell for pair in self.portals for cell in pair}
        free = [(x, y) for x in range(COLS) for y in range(ROWS) if (x, y) not in taken]
        for pair in self.portals:
            pair[1] = free.pop(int(self.np_random.integers(len(free))))

    def _drift(self):
        if self.steps % DRIFT_GAP == 0:
            self._enter_drifter()
        reward, staying = 0.0, []
        wx, wy = centre(self.walker)
        for thing in self.drifters:
            self._move_drifter(thing, wx, wy)
            distance = math.hypot(thing.x - wx, thing.y - wy)
            if distance < 4:
                if thing.nightmare:
                    self.lives -= 1
                    reward -= 0.5
                else:
                    self.feathers += 1
                    reward += 0.2
            elif thing.strayed and math.dist((thing.x, thing.y), centre(self.bed[0])) < 4:
                self.strayed += 1
                reward -= 0.1
            elif -3 <= thing.x < 87 and TOP - 3 <= thing.y < 87:
                staying.append(thing)
        self.drifters = staying
        return reward

    def _enter_drifter(self):
        side = int(self.np_random.integers(4))
        along = float(self.np_random.uniform(TOP + 8, 78))
        slant = float(self.np_random.uniform(-0.25, 0.25))
        x, y, vx, vy = [
            (0.0, along, DRIFT_SPEED, slant),
            (83.0, along, -DRIFT_SPEED, slant),
            (along, float(TOP), slant, DRIFT_SPEED),
            (along, 83.0, slant, -DRIFT_SPEED),
        ][side]
        self.drifters.append(Drifter(x, y, vx, vy, nightmare=int(self.np_random.integers(3)) == 0))

    def _move_drifter(self, thing, wx, wy):
        dx, dy = wx - thing.x, wy - thing.y
        distance = max(math.hypot(dx, dy), 0.1)
        if thing.strayed:
            bx, by = centre(self.bed[0])
            away = max(math.hypot(bx - thing.x, by - thing.y), 0.1)
            thing.vx, thing.vy = DRIFT_SPEED * (bx - thing.x) / away, DRIFT_SPEED * (by - thing.y) / away
        vx, vy = thing.vx, thing.vy
        if self.magnet and distance < MAGNET_REACH:
            vx, vy = vx + MAGNET_PULL * dx / distance, vy + MAGNET_PULL * dy / distance
        elif thing.nightmare and distance < self.light + 2:
            # A nightmare shuns the light and slides along its edge.
            vx, vy = vx - 0.8 * dx / distance, vy - 0.8 * dy / distance
        thing.x += vx
        thing.y += vy
        thing.rest = max(0, thing.rest - 1)
        if thing.rest:
            return
        cell = (int(thing.x) // CELL, (int(thing.y) - TOP) // CELL)
        for one, other in self.portals:
            if cell in (one, other):
                thing.x, thing.y = centre(other if cell == one else one)
                thing.rest = PORTAL_REST
                thing.strayed = thing.nightmare
                return

    def _info(self):
        return {"is_success": self.won, "lives": self.lives, "feathers": self.feathers, "strayed": self.strayed}

    # ------------------------------------------------------------------ the picture

    def render(self):
        frame = FLOOR.copy()
        for cell in self.pits:
            self._cell(frame, cell, 0, PIT)
        for cell in self.pillows:
            self._cell(frame, cell, 1, LAVENDER)
        for cell in self.bed:
            self._cell(frame, cell, 0, QUILT)
            self._cell(frame, cell, 2, QUILT_DARK)
        for tone, pair in zip(PORTAL_TONES, self.portals):
            for cell in pair:
                self._cell(frame, cell, 0, tone)
                self._cell(frame, cell, 1, VOID)
                self._cell(frame, cell, 2, tone)
        for thing in self.drifters:
            self._dot(frame, thing.x, thing.y, NIGHTMARE if thing.nightmare else STAR)
        wx, wy = centre(self.walker)
        dark = np.add.outer((PIXEL - wy) ** 2, (PIXEL - wx) ** 2) > self.light**2
        frame[dark] = VOID
        for cell in self.lamps:
            lit = math.dist(centre(cell), (wx, wy)) < self.light
            self._cell(frame, cell, 2, OIL_GOLD if lit else OIL_FAINT)
        self._cell(frame, self.twin, 1, (120, 190, 255))
        self._cell(frame, self.walker, 0, STAR)
        self._cell(frame, self.walker, 2, QUILT if not self.magnet else (80, 255, 160))
        frame[:TOP] = VOID
        for k in range(self.lives):
            frame[1:5, 2 + 6 * k : 6 + 6 * k] = STAR
        frame[2:4, 30 : 30 + min(self.light, 40)] = OIL_GOLD
        for k in range(self.strayed):
            frame[1:5, 80 - 3 * k : 82 - 3 * k] = NIGHTMARE
        return frame

    @staticmethod
    def _cell(frame, cell, inset, colour):
        x, y = cell[0] * CELL, TOP + cell[1] * CELL
        frame[y + inset : y + CELL - inset, x + inset : x + CELL - inset] = colour

    @staticmethod
    def _dot(frame, x, y, colour):
        x, y = int(x), int(y)
        frame[max(TOP, y - 1) : max(TOP, y + 2), max(0, x - 1) : max(0, x + 2)] = colour
