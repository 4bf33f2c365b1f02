"""Satellite Belt: a repair pod drifts through a closing orbit and gathers solar cells that push the border back.

The pod rises and sinks by letting gas in and out, paddles sideways, and freezes debris shards with a short ray. Dead
satellites lie on plates in the floor; as long as something lies on a plate its gate stays open.
"""

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
POD_R = 3
PADDLE, RISE, GAS, LEVEL = 1.5, 1.5, 0.18, 0.96
RAY, COLD, FASTER = 12, 140, 1.15
SHARDS, SHARD_SPEED, SHARD_R = 5, 0.35, 2
CREEP, RELIEF, START_INSET = 8, 3, 3
CELLS = 16
CELL_AWAY = 30
LIVES, GRACE = 3, 30
MOST_CRUSHED, GATE_DELAY = 3, 15
MAX_STEPS = 800

FLOOR = 77
LEDGES = [pygame.Rect(0, 34, 44, 2), pygame.Rect(40, 58, 44, 2)]  # 22 pixels of passage between them
# Vertical bars as (x, top, bottom); the plates lie in the floor of the lowest passage.
GATES = [(60, 6, 34), (30, 36, 58), (54, 36, 58), (22, 60, 77)]
PLATES = [32, 45, 58, 71]
PLATE_W, SATELLITE_W, SATELLITE_H = 8, 6, 5

SPACE, STAR = (6, 6, 18), (150, 150, 190)
PLANET, AIR = (30, 80, 170), (90, 150, 230)
VIOLET, VIOLET_DARK = (140, 90, 210), (80, 50, 130)
STEEL, STEEL_DARK = (150, 156, 170), (90, 94, 110)
WHITE, ICE, ROCK = (245, 245, 255), (150, 230, 255), (190, 120, 80)
POD, GLASS = (250, 200, 80), (60, 200, 230)
DANGER = (220, 40, 90)
GREEN, AMBER = (90, 230, 120), (250, 170, 40)


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = self.taken = self.crushed = 0
        self.lives, self.grace = LIVES, GRACE
        self.inset = START_INSET
        self.x, self.y, self.vy, self.facing = 20.0, 20.0, 0.0, 1
        self.ray = 0
        self.won = False
        self.satellites = [float(plate + 1) for plate in PLATES[:3]]
        self.closing = [GATE_DELAY] * 3 + [0]  # steps until each gate closes; 0 is closed
        self.shards = []  # [x, y, vx, vy, steps frozen]
        for _ in range(SHARDS):
            angle = float(self.np_random.uniform(0, 2 * np.pi))
            x, y = self.np_random.uniform((36, 12), (74, 70)).tolist()
            self.shards.append([x, y, SHARD_SPEED * np.cos(angle), SHARD_SPEED * np.sin(angle), 0])
        self.stars = self.np_random.integers(0, SIZE, size=(30, 2)).tolist()
        self._place_cell()
        return self.render(), self._info()

    def _place_cell(self):
        """The next solar cell lies just inside the border, on the side to which the pod is nearest."""
        low, high = self.inset + 6, SIZE - 1 - self.inset - 6
        for _ in range(30):
            shift = float(self.np_random.integers(-CELL_AWAY, CELL_AWAY + 1))
            column, row = (float(np.clip(round(v) + shift, low, high)) for v in (self.x, self.y))
            sides = {(low, row): self.x, (high, row): SIZE - self.x, (column, low): self.y, (column, high): SIZE - self.y}
            x, y = min(sides, key=sides.get)
            y = min(y, FLOOR - 6)
            box = pygame.Rect(int(x) - 7, int(y) - 7, 14, 14)
            clear = not any(box.colliderect(ledge) for ledge in LEDGES)
            if clear and all(abs(x - gate[0]) > 6 for gate in GATES) and abs(x - self.x) + abs(y - self.y) > 14:
                self.cell = (float(x), float(y))
                return
        self.cell = (42.0, 47.0)

    # ---------------------------------------------------------------------------------------------------------------

    def step(self, action):
        move, ray, _ = (int(part) for part in action)
        self.steps += 1
        reward = 0.0
        if not (self.won or self.lives <= 0 or self.crushed >= MOST_CRUSHED):
            self.grace = max(0, self.grace - 1)
            reward += self._drift(move)
            reward += self._freeze() if ray else 0.0
            self.ray = 2 if ray else max(0, self.ray - 1)
            reward += self._roam() + self._work_gates() + self._close_in() + self._take_cell()
        terminated = bool(self.won or self.lives <= 0 or self.crushed >= MOST_CRUSHED)
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), float(reward), terminated, truncated, self._info()

    def _hurt(self):
        if self.grace:
            return 0.0
        self.lives -= 1
        self.grace = GRACE
        return -1.0

    def _drift(self, move):
        if move == 1:
            self.vy = max(-RISE, self.vy - GAS)
        elif move == 2:
            self.vy = min(RISE, self.vy + GAS)
        self.vy *= LEVEL
        x, y = self.x, self.y + self.vy
        if move in (3, 4):
            self.facing = 1 if move == 4 else -1
            x += PADDLE * self.facing
        y = float(np.clip(y, 8 + POD_R, FLOOR - POD_R))
        x = float(np.clip(x, POD_R, SIZE - 1 - POD_R))
        box = pygame.Rect(int(x) - POD_R, int(y) - POD_R, 2 * POD_R + 1, 2 * POD_R + 1)
        if any(box.colliderect(ledge) for ledge in LEDGES):
            self.vy = -0.6 * self.vy
            return self._hurt()
        if any(self.closing[i] == 0 and box.colliderect(self._bar(i)) for i in range(4)) or self._meets_ice(box):
            self.vy = 0.0
            return 0.0
        self.x, self.y = x, y
        self._shove(box)
        return 0.0

    def _bar(self, number):
        x, top, bottom = GATES[number]
        return pygame.Rect(x, top, 2, bottom - top)

    def _meets_ice(self, box):
        return any(shard[4] and box.collidepoint(shard[0], shard[1]) for shard in self.shards)

    def _shove(self, box):
        for i, left in enumerate(self.satellites):
            if box.colliderect((int(left), FLOOR - SATELLITE_H, SATELLITE_W, SATELLITE_H)):
                target = left + PADDLE * (1 if left + SATELLITE_W / 2 > self.x else -1)
                others = self.satellites[:i] + self.satellites[i + 1 :]
                if 0 <= target <= SIZE - SATELLITE_W and all(abs(target - other) >= SATELLITE_W for other in others):
                    self.satellites[i] = target

    def _freeze(self):
        for shard in self.shards:
            ahead = (shard[0] - self.x) * self.facing
            if not shard[4] and 0 < ahead <= RAY + POD_R and abs(shard[1] - self.y) < 5:
                shard[4] = COLD
                return 0.1
        return 0.0

    def _roam(self):
        reward = 0.0
        low, high = 8, SIZE - 8
        for shard in self.shards:
            if shard[4]:
                shard[4] -= 1
                if not shard[4]:
                    shard[2], shard[3] = shard[2] * FASTER, shard[3] * FASTER
                continue
            for axis, top in ((0, high), (1, FLOOR - 4)):
                shard[axis] += shard[axis + 2]
                if not low < shard[axis] < top:
                    shard[axis] = float(np.clip(shard[axis], low, top))
                    shard[axis + 2] = -shard[axis + 2]
            if abs(shard[0] - self.x) < POD_R + SHARD_R and abs(shard[1] - self.y) < POD_R + SHARD_R:
                reward += self._hurt()
        return reward

    def _weighed_down(self, plate):
        right = plate + PLATE_W
        if any(left + SATELLITE_W > plate and left < right for left in self.satellites):
            return True
        if plate <= self.x <= right and self.y > FLOOR - 6:
            return True
        return any(shard[4] and plate <= shard[0] <= right and shard[1] > FLOOR - 8 for shard in self.shards)

    def _work_gates(self):
        reward = 0.0
        for i, plate in enumerate(PLATES):
            if self._weighed_down(plate):
                self.closing[i] = GATE_DELAY
            elif self.closing[i]:
                self.closing[i] -= 1
                if not self.closing[i]:
                    reward -= 0.5 * self._crush(i)
        return reward

    def _crush(self, number):
        bar = self._bar(number)
        kept = [
            left for left in self.satellites if not bar.colliderect((int(left), FLOOR - SATELLITE_H, SATELLITE_W, SATELLITE_H))
        ]
        lost = len(self.satellites) - len(kept)
        self.satellites = kept
        self.crushed += lost
        return lost

    def _close_in(self):
        if self.steps % CREEP == 0:
            self.inset += 1
        # The border shoves the solar cell inwards, too.
        low, high = self.inset + 6, SIZE - 1 - self.inset - 6
        self.cell = tuple(float(np.clip(v, low, high)) for v in self.cell)
        edge = self.inset + POD_R
        if edge <= self.x <= SIZE - 1 - edge and edge <= self.y <= SIZE - 1 - edge:
            return 0.0
        price = self._hurt()
        if price:
            self.inset = max(START_INSET, self.inset - 2 * RELIEF)
        return price

    def _take_cell(self):
        if abs(self.cell[0] - self.x) > POD_R + 3 or abs(self.cell[1] - self.y) > POD_R + 3:
            return 0.0
        self.taken += 1
        self.inset = max(START_INSET, self.inset - RELIEF)
        if self.taken == CELLS:
            self.won = True
            return 5.0
        self._place_cell()
        return 1.0

    def _info(self):
        return {
            "is_success": self.won,
            "cells": self.taken,
            "lives": self.lives,
            "inset": self.inset,
            "crushed": self.crushed,
        }

    # ---------------------------------------------------------------------------------------------------------------

    def render(self):
        screen = pygame.Surface((SIZE, SIZE), 0, 32)
        screen.fill(SPACE)
        for x, y in self.stars:
            screen.set_at((x, y), STAR)
        pygame.draw.circle(screen, AIR, (42, 190), 121)
        pygame.draw.circle(screen, PLANET, (42, 190), 118)
        screen.fill(STEEL_DARK, (0, FLOOR, SIZE, 2))
        for ledge in LEDGES:
            screen.fill(VIOLET, ledge)
            screen.fill(VIOLET_DARK, (ledge.x, ledge.bottom - 1, ledge.width, 1))
        for i, plate in enumerate(PLATES):
            ink = GREEN if self.closing[i] == GATE_DELAY else AMBER if self.closing[i] else STEEL
            screen.fill(ink, (plate, FLOOR - 1, PLATE_W, 2))
            bar = self._bar(i)
            if self.closing[i]:
                screen.fill(ink, (bar.x, bar.y, 2, 2))
                screen.fill(ink, (bar.x, bar.bottom - 2, 2, 2))
            else:
                screen.fill(STEEL, bar)
        for left in self.satellites:
            screen.fill(VIOLET_DARK, (int(left), FLOOR - SATELLITE_H, SATELLITE_W, SATELLITE_H))
            screen.fill(STEEL, (int(left) + 2, FLOOR - SATELLITE_H, 2, SATELLITE_H))
        cx, cy = int(self.cell[0]), int(self.cell[1])
        screen.fill(WHITE, (cx - 3, cy - 3, 7, 7))
        screen.fill(PLANET, (cx - 2, cy - 2, 5, 5))
        pygame.draw.line(screen, WHITE, (cx, cy - 2), (cx, cy + 2))
        for x, y, _, _, frozen in self.shards:
            if frozen:
                screen.fill(ICE, (int(x) - 3, int(y) - 3, 7, 7))
            pygame.draw.polygon(screen, ROCK, [(x - 2, y + 1), (x, y - 2), (x + 2, y + 2)])
        if not (self.grace and self.steps % 4 < 2):
            x, y = int(self.x), int(self.y)
            pygame.draw.circle(screen, POD, (x, y), POD_R)
            screen.fill(GLASS, (x + self.facing, y - 1, 2, 2))
            if self.ray:
                pygame.draw.line(screen, ICE, (x + 4 * self.facing, y), (x + (POD_R + RAY) * self.facing, y))
        pygame.draw.rect(screen, DANGER, (0, 0, SIZE, SIZE), max(1, self.inset))
        for life in range(max(0, self.lives)):
            screen.fill(POD, (2 + 5 * life, 1, 3, 2))
        screen.fill(WHITE, (30, 1, 3 * self.taken, 2))
        return np.ascontiguousarray(pygame.surfarray.array3d(screen).transpose(1, 0, 2))
