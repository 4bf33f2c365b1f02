"""Container Harbour: drive a forklift over a quay that crumbles behind it, with a wrecking ball on an elastic tether.

Left and right turn on the spot, up drives, down reverses. The first button, held and let go, swings the fork all round.
Runaway trucks close in from all sides; the swung ball and the swung fork knock them out.
"""

import math
import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
MAX_STEPS = 900
LIVES = 4
DENTS_TO_LOSE = 5

TILE = 6
GRID_W, GRID_H = 10, 9
QUAY = pygame.Rect(12, 18, GRID_W * TILE, GRID_H * TILE)
FIRM_TILES = 16
SHARE_TO_WALK = 0.75
CRUMBLE_DELAY = 6
REGROW = 120

TURN = math.radians(10)
SPEED = 2.0
CONTAINERS = 6
SWING_LEAST, SWING_MOST, SWING_CHARGE = 8, 22, 10

TETHER = 16
STRETCH = 0.06
BALL_DRAG = 0.97
KNOCK_SPEED = 2.0
SPIKES = 4

TRUCK_GAP = 25
FIRST_WAVE = 2
TRUCK_SPEED = 2.0
TRUCK_TOUCH = 5

SEA = (70, 88, 104)
SEA_WAVE = (88, 106, 122)
CONCRETE = (150, 152, 150)
WALKED = (176, 180, 140)
CRACKED = (120, 112, 100)
HOLE = (24, 34, 46)
FIRM_RIM = (230, 224, 180)
CONTAINER_TONES = [(40, 90, 170), (52, 110, 190), (30, 76, 150)]
SIGNAL_RED = (220, 44, 44)
YELLOW = (246, 204, 50)
FORK = (60, 60, 64)
BALL = (40, 40, 46)
TRUCK_GLASS = (250, 220, 220)
BAY = (120, 210, 140)

SOLID, CRACKING, GONE = 0, 1, 2


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ quay

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.dents = 0
        self.knocked = 0
        self.won = self.lost = False
        self.x, self.y = float(QUAY.centerx), float(QUAY.centery)
        self.heading = float(self.np_random.integers(36)) * TURN
        self.charge = 0
        self.strike = 0  # radius of the swing that is shown
        self._lay_tiles()
        self.tile = self._tile_at(self.x, self.y)
        self.ball = [self.x - 10.0, self.y, 0.0, 0.0]  # x, y, vx, vy; None while it is lost
        self.trucks = []  # [x, y]
        self.wave = FIRST_WAVE
        self._send_wave()
        return self.render(), self._info()

    def _lay_tiles(self):
        cells = [(i, j) for i in range(GRID_W) for j in range(GRID_H)]
        order = [cells[k] for k in self.np_random.permutation(len(cells))]
        middle = (GRID_W // 2, GRID_H // 2)
        far = [c for c in order if abs(c[0] - middle[0]) + abs(c[1] - middle[1]) > 2]
        self.containers = far[:CONTAINERS]
        self.spikes = far[CONTAINERS : CONTAINERS + SPIKES]
        firm = far[:FIRM_TILES] + [middle]
        self.firm = np.zeros((GRID_W, GRID_H), bool)
        for cell in firm:
            self.firm[cell] = True
        self.bay = far[FIRM_TILES - 1]
        self.state = np.zeros((GRID_W, GRID_H), int)
        self.timer = np.zeros((GRID_W, GRID_H), int)
        self.walked = np.zeros((GRID_W, GRID_H), bool)
        self.needed = math.ceil(SHARE_TO_WALK * int((~self.firm).sum()))

    def _tile_at(self, x, y):
        i = min(max(int(x - QUAY.x) // TILE, 0), GRID_W - 1)
        j = min(max(int(y - QUAY.y) // TILE, 0), GRID_H - 1)
        return i, j

    def _tile_rect(self, cell):
        return pygame.Rect(QUAY.x + cell[0] * TILE, QUAY.y + cell[1] * TILE, TILE, TILE)

    # ------------------------------------------------------------------ step

    def step(self, action):
        move, hold = int(action[0]), bool(action[1])
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        reward = self._drive(move, hold)
        reward += self._crumble()
        reward += self._swing(hold)
        self._pull_ball()
        reward += self._run_trucks()
        if int(self.walked.sum()) >= self.needed:
            self.won = True
            reward += 5.0
        elif self.lives <= 0 or self.dents >= DENTS_TO_LOSE:
            self.lost = True
            reward -= 1.0
        terminated = self.won or self.lost
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.render(), float(reward), terminated, truncated, self._info()

    def _info(self):
        return {
            "is_success": self.won,
            "walked": int(self.walked.sum()),
            "lives": self.lives,
            "dents": self.dents,
            "knocked": self.knocked,
        }

    def _drive(self, move, hold):
        if move == 3:
            self.heading -= TURN
        elif move == 4:
            self.heading += TURN
        pace = {1: SPEED, 2: -SPEED / 2}.get(move, 0.0) * (0.5 if hold else 1.0)
        if not pace:
            return 0.0
        x = min(max(self.x + pace * math.cos(self.heading), QUAY.left + 2), QUAY.right - 3)
        y = min(max(self.y + pace * math.sin(self.heading), QUAY.top + 2), QUAY.bottom - 3)
        if self._tile_at(x, y) in self.containers:
            self.dents += 1
            # The forklift rebounds, so that leaning on a container is one dent and not ten.
            self.x -= 2.5 * pace * math.cos(self.heading)
            self.y -= 2.5 * pace * math.sin(self.heading)
            self.x = min(max(self.x, QUAY.left + 2), QUAY.right - 3)
            self.y = min(max(self.y, QUAY.top + 2), QUAY.bottom - 3)
            return -0.3
        self.x, self.y = x, y
        return 0.0

    def _crumble(self):
        reward = 0.0
        self.timer[self.timer > 0] -= 1
        ended = (self.timer == 0) & (self.state != SOLID)
        gone = ended & (self.state == CRACKING)
        self.state[ended & (self.state == GONE)] = SOLID
        self.state[gone] = GONE
        self.timer[gone] = REGROW
        cell = self._tile_at(self.x, self.y)
        if cell != self.tile:
            if not self.firm[self.tile] and self.state[self.tile] == SOLID:
                self.state[self.tile] = CRACKING
                self.timer[self.tile] = CRUMBLE_DELAY
            self.tile = cell
        if not self.firm[cell] and not self.walked[cell]:
            self.walked[cell] = True
            reward += 0.05
        if self.state[cell] == GONE:
            self.lives -= 1
            self.x, self.y = (float(v) for v in QUAY.center)
            self.tile = self._tile_at(self.x, self.y)
            reward -= 0.5
        return reward

    def _swing(self, hold):
        self.strike = 0
        if hold:
            self.charge = min(SWING_CHARGE, self.charge + 1)
            return 0.0
        if not self.charge:
            return 0.0
        self.strike = SWING_LEAST + (SWING_MOST - SWING_LEAST) * self.charge // SWING_CHARGE
        self.charge = 0
        return self._knock([t for t in self.trucks if math.hypot(t[0] - self.x, t[1] - self.y) <= self.strike])

    def _knock(self, hit):
        for truck in hit:
            self.trucks.remove(truck)
        self.knocked += len(hit)
        return 0.2 * len(hit)

    def _pull_ball(self):
        if self.ball is None:
            if self._tile_at(self.x, self.y) == self.bay:
                self.ball = [self.x, self.y, 0.0, 0.0]
            return
        bx, by, vx, vy = self.ball
        dx, dy = self.x - bx, self.y - by
        distance = math.hypot(dx, dy)
        if distance > TETHER:
            pull = STRETCH * (distance - TETHER)
            vx += pull * dx / distance
            vy += pull * dy / distance
            self.x -= 0.2 * pull * dx / distance
            self.y -= 0.2 * pull * dy / distance
        vx, vy = vx * BALL_DRAG, vy * BALL_DRAG
        self.ball = [bx + vx, by + vy, vx, vy]
        inside = QUAY.collidepoint(self.ball[0], self.ball[1])
        if inside and self._tile_at(self.ball[0], self.ball[1]) in self.spikes:
            self.ball = None

    def _send_wave(self):
        for _ in range(self.wave):
            side = int(self.np_random.integers(4))
            along = float(self.np_random.uniform(10, 74))
            self.trucks.append([[along, 8.0], [along, 82.0], [2.0, along], [82.0, along]][side])
        self.wave += 1

    def _run_trucks(self):
        if self.steps % TRUCK_GAP == 0:
            self._send_wave()
        reward = 0.0
        for truck in self.trucks:
            dx, dy = self.x - truck[0], self.y - truck[1]
            distance = max(math.hypot(dx, dy), 0.1)
            truck[0] += TRUCK_SPEED * dx / distance
            truck[1] += TRUCK_SPEED * dy / distance
            if distance < TRUCK_TOUCH:
                self.lives -= 1
                reward -= 0.5
        if self.ball is not None and math.hypot(self.ball[2], self.ball[3]) > KNOCK_SPEED:
            bx, by = self.ball[:2]
            reward += self._knock([t for t in self.trucks if math.hypot(t[0] - bx, t[1] - by) < 5])
        return reward

    # ------------------------------------------------------------------ picture

    def render(self):
        canvas = pygame.Surface((SIZE, SIZE))
        canvas.fill(SEA)
        for y in range(8, SIZE, 6):
            shift = (self.steps // 6 + 5 * y) % 14
            for x in range(shift - 14, SIZE, 14):
                pygame.draw.line(canvas, SEA_WAVE, (x, y), (x + 4, y))
        pygame.draw.rect(canvas, (58, 52, 60), (0, 8, SIZE, 6))
        pygame.draw.rect(canvas, SIGNAL_RED, (0, 13, SIZE, 1))
        for i in range(GRID_W):
            for j in range(GRID_H):
                self._draw_tile(canvas, (i, j))
        for number, cell in enumerate(self.containers):
            box = self._tile_rect(cell)
            canvas.fill(CONTAINER_TONES[number % 3], box)
            pygame.draw.line(canvas, SEA, box.topleft, box.bottomleft)
        for cell in self.spikes:
            box = self._tile_rect(cell)
            pygame.draw.polygon(canvas, FORK, [box.bottomleft, box.midtop, box.bottomright])
        pygame.draw.rect(canvas, BAY, self._tile_rect(self.bay), width=2)
        if self.strike:
            pygame.draw.circle(canvas, YELLOW, (self.x, self.y), self.strike, width=1)
        if self.ball is not None:
            pygame.draw.line(canvas, YELLOW, (self.x, self.y), self.ball[:2])
            pygame.draw.circle(canvas, BALL, self.ball[:2], 3)
        for x, y in self.trucks:
            canvas.fill(SIGNAL_RED, (int(x) - 3, int(y) - 2, 7, 5))
            canvas.fill(TRUCK_GLASS, (int(x) - 1, int(y) - 1, 2, 3))
        self._draw_forklift(canvas)
        self._draw_counts(canvas)
        return np.ascontiguousarray(pygame.surfarray.array3d(canvas).swapaxes(0, 1))

    def _draw_tile(self, canvas, cell):
        box = self._tile_rect(cell)
        state = self.state[cell]
        if state == GONE:
            canvas.fill(HOLE, box)
            return
        colour = CRACKED if state == CRACKING else WALKED if self.walked[cell] else CONCRETE
        canvas.fill(colour, box.inflate(-1, -1))
        if self.firm[cell]:
            pygame.draw.rect(canvas, FIRM_RIM, box, width=1)

    def _draw_forklift(self, canvas):
        c, s = math.cos(self.heading), math.sin(self.heading)

        def point(ahead, aside):
            return self.x + ahead * c - aside * s, self.y + ahead * s + aside * c

        pygame.draw.polygon(canvas, YELLOW, [point(-3, -3), point(2, -3), point(2, 3), point(-3, 3)])
        for aside in (-2, 2):
            pygame.draw.line(canvas, FORK, point(2, aside), point(5, aside))

    def _draw_counts(self, canvas):
        canvas.fill((20, 26, 34), (0, 0, SIZE, 7))
        part = min(1.0, int(self.walked.sum()) / self.needed)
        canvas.fill(WALKED, (2, 2, int(40 * part), 3))
        for k in range(self.lives):
            canvas.fill(YELLOW, (46 + 5 * k, 1, 4, 5))
        for k in range(self.dents):
            canvas.fill(SIGNAL_RED, (SIZE - 4 - 3 * k, 1, 2, 5))
