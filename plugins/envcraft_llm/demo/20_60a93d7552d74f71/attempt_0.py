"""Frozen Lake: a skater catches frozen berries in a basket and carries them to the fishing hut.

Seals tumble down among the berries, heaps of snow-covered earth lie in the way and have to be dug through, and a ball
that breaks the snowballs above must never get past the skater. A full basket makes slow; the first button sprints.
"""

import math

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
ICE_Y = 74
HUT_WIDTH = 11
SKATER_W, SKATER_H = 6, 9
SPEED, BREATH, BREATH_BACK = 2.5, 35, 0.5
FULL, GOAL, MOST_MISSED = 5, 18, 9

PLACES = [16 + 9 * k for k in range(8)]
DROP_EVERY, SEAL_RATIO, FALL = 16, 6, 0.9
SWAY = 4.0
CATCH_W = 9

HEAP_W, HEAP_SHARE, DIG_STEPS = 6, 0.35, 6
GEM_CHANCE, NEST_CHANCE, GEM_REWARD = 0.2, 0.1, 1.0
SEAL_CRAWL = 0.5

BALL_SPEED, BALL_R = 1.5, 2
ROWS, COLUMNS, BRICK_W, BRICK_H, BRICK_TOP = 5, 12, 7, 3, 9
LIVES, GRACE = 2, 25
MAX_STEPS = 900

SKY, ICE, ICE_DARK, CRACK = (206, 228, 244), (150, 204, 232), (104, 166, 206), (40, 70, 110)
SNOW, SNOW_BLUE, PINE, TRUNK = (250, 252, 255), (214, 226, 240), (30, 92, 70), (90, 62, 42)
BERRY, BERRY_LIGHT, LEAF = (206, 30, 62), (255, 120, 140), (40, 130, 70)
SEAL, SEAL_DARK = (96, 104, 122), (50, 56, 70)
COAT, SCARF, SKIN = (40, 80, 160), (250, 200, 60), (244, 208, 176)
BASKET, EARTH, HUT, HUT_DOOR = (160, 110, 60), (122, 96, 76), (140, 60, 50), (60, 30, 30)
BALL = (20, 30, 60)


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.x = 40.0  # left edge of the skater
        self.facing = 1
        self.breath = float(BREATH)
        self.basket = self.shelf = self.missed = 0
        self.lives, self.grace = LIVES, 0
        self.falling = []  # [place, y, sways, is a seal]
        self.crawling = []  # seals from nests: [x, direction]
        self.digging = 0
        self.heaps = {}  # column of six pixels: what lies under it
        for column in range(3, SIZE // HEAP_W):
            if self.np_random.random() < HEAP_SHARE and column not in (6, 7):
                luck = self.np_random.random()
                self.heaps[column] = "berry" if luck < GEM_CHANCE else "nest" if luck < GEM_CHANCE + NEST_CHANCE else ""
        self.bricks = np.ones((ROWS, COLUMNS), bool)
        self.ball = [float(self.np_random.integers(30, 60)), 40.0]
        self._aim_ball(-1)
        self.won = False
        return self._draw(), self._info()

    def _aim_ball(self, upwards):
        angle = float(self.np_random.uniform(0.5, 1.0)) * (1 if self.np_random.integers(2) else -1)
        self.ball_v = [BALL_SPEED * math.sin(angle), upwards * BALL_SPEED * math.cos(angle)]

    # ------------------------------------------------------------------ rules

    def step(self, action):
        move, sprint, _ = (int(part) for part in action)
        if self.over:
            return self._draw(), 0.0, True, False, self._info()
        self._skate(move, sprint)
        if self.x < HUT_WIDTH - 4:
            # Inside the hut nothing can happen to the skater.
            reward = self._empty_basket()
        else:
            reward = self._dig() + self._update_lake()
        terminated = self.over
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._draw(), float(reward), terminated, truncated, self._info()

    @property
    def over(self):
        return bool(self.won or self.lives <= 0 or self.missed >= MOST_MISSED)

    def _update_lake(self):
        """Everything on the lake moves on by one step."""
        self.steps += 1
        self.grace = max(0, self.grace - 1)
        return self._drop_things() + self._crawl() + self._bounce_ball()

    def _hurt(self):
        if self.grace:
            return 0.0
        self.lives -= 1
        self.grace = GRACE
        return -1.0

    def _skate(self, move, sprint):
        speed = SPEED / 2 if self.basket >= FULL else SPEED
        if sprint and self.breath >= 1 and move in (3, 4):
            speed *= 2
            self.breath -= 1
        else:
            self.breath = min(float(BREATH), self.breath + BREATH_BACK)
        if move not in (3, 4):
            return
        way = 1 if move == 4 else -1
        self.facing = way
        target = min(max(self.x + way * speed, 0.0), float(SIZE - SKATER_W))
        front = target + SKATER_W - 1 if way > 0 else target
        column = int(front) // HEAP_W
        if column in self.heaps:
            self.digging += 1
            return
        self.digging = 0
        self.x = target

    def _dig(self):
        if self.digging < DIG_STEPS:
            return 0.0
        self.digging = 0
        edge = self.x + SKATER_W if self.facing > 0 else self.x - 1
        near = [column for column in self.heaps if abs((column + 0.5) * HEAP_W - edge) < HEAP_W + 2]
        if not near:
            return 0.0
        column = min(near, key=lambda heap: abs((heap + 0.5) * HEAP_W - edge))
        found = self.heaps.pop(column)
        if found == "nest":
            self.crawling.append([float(column * HEAP_W), self.facing])
        return GEM_REWARD if found == "berry" else 0.0

    def _empty_basket(self):
        brought = min(self.basket, GOAL - self.shelf)
        self.basket = 0
        self.shelf += brought
        if self.shelf >= GOAL:
            self.won = True
            return brought * 0.5 + 5.0
        return brought * 0.5

    def fall_x(self, thing):
        return PLACES[thing[0]] + (SWAY * math.sin(thing[1] / 9) if thing[2] else 0.0)

    def _drop_things(self):
        if self.steps % DROP_EVERY == 0:
            place, sways = int(self.np_random.integers(8)), bool(self.np_random.integers(2))
            self.falling.append([place, 26.0, sways, self.np_random.integers(SEAL_RATIO) == 0])
        reward, kept = 0.0, []
        for thing in self.falling:
            thing[1] += FALL
            caught = abs(self.fall_x(thing) - self.x - SKATER_W / 2) < CATCH_W / 2 + 2
            if ICE_Y - SKATER_H - 2 < thing[1] < ICE_Y - 3 and caught:
                if thing[3]:
                    reward += self._hurt()
                else:
                    self.basket += 1
                    reward += 0.2
            elif thing[1] >= ICE_Y:
                self.missed += not thing[3]
            else:
                kept.append(thing)
        self.falling = kept
        return reward

    def _crawl(self):
        reward = 0.0
        for seal in list(self.crawling):
            seal[0] += SEAL_CRAWL * seal[1]
            if not HUT_WIDTH < seal[0] < SIZE:
                self.crawling.remove(seal)
            elif abs(seal[0] - self.x - SKATER_W / 2) < 4:
                self.crawling.remove(seal)
                reward += self._hurt()
        return reward

    def _bounce_ball(self):
        self.ball[0] += self.ball_v[0]
        self.ball[1] += self.ball_v[1]
        if not HUT_WIDTH + BALL_R < self.ball[0] < SIZE - BALL_R:
            self.ball[0] = min(max(self.ball[0], HUT_WIDTH + BALL_R), SIZE - BALL_R)
            self.ball_v[0] = -self.ball_v[0]
        if self.ball[1] < BRICK_TOP:
            self.ball_v[1] = abs(self.ball_v[1])
        row, column = int(self.ball[1] - BRICK_TOP) // BRICK_H, int(self.ball[0]) // BRICK_W
        if 0 <= row < ROWS and 0 <= column < COLUMNS and self.bricks[row, column]:
            self.bricks[row, column] = False
            self.ball_v[1] = -self.ball_v[1]
            return 0.1
        if self.ball[1] > ICE_Y - SKATER_H and abs(self.ball[0] - self.x - SKATER_W / 2) < 7 and self.ball_v[1] > 0:
            self._aim_ball(-1)
        elif self.ball[1] > ICE_Y + 2:
            self.ball = [48.0, 34.0]
            self._aim_ball(-1)
            return self._hurt()
        return 0.0

    def _info(self):
        return {"is_success": self.won, "shelf": self.shelf, "missed": self.missed, "lives": self.lives}

    # ---------------------------------------------------------------- picture

    def _draw(self):
        lake = pygame.Surface((SIZE, SIZE), 0, 32)
        lake.fill(SKY)
        for x in (16, 37, 61, 76):
            pygame.draw.polygon(lake, PINE, [(x - 5, 58), (x, 40), (x + 5, 58)])
            lake.fill(TRUNK, (x - 1, 58, 2, 3))
        pygame.draw.ellipse(lake, SNOW, (-20, 54, 130, 30))
        lake.fill(ICE, (0, ICE_Y - 8, SIZE, 18))
        lake.fill(ICE_DARK, (0, ICE_Y + 3, SIZE, 7))
        for x in (22, 47, 70):
            pygame.draw.lines(lake, CRACK, False, [(x, ICE_Y + 2), (x + 4, ICE_Y + 5), (x + 3, ICE_Y + 8)])
        for row, column in np.argwhere(self.bricks).tolist():
            ink = SNOW if (row + column) % 2 else SNOW_BLUE
            pygame.draw.ellipse(lake, ink, (column * BRICK_W, BRICK_TOP + row * BRICK_H, BRICK_W, BRICK_H + 1))
        for column in self.heaps:
            pygame.draw.polygon(lake, EARTH, [(column * 6, ICE_Y), (column * 6 + 3, ICE_Y - 5), (column * 6 + 5, ICE_Y)])
            lake.fill(SNOW, (column * 6 + 2, ICE_Y - 5, 2, 1))
        pygame.draw.polygon(lake, HUT, [(0, 62), (5, 55), (HUT_WIDTH, 62)])
        lake.fill(HUT, (0, 62, HUT_WIDTH, 12))
        lake.fill(HUT_DOOR, (3, 65, 5, 9))
        self._draw_things(lake)
        self._draw_skater(lake)
        lake.fill(ICE_DARK, (0, 0, SIZE, 7))
        for berry in range(self.shelf):  # the shelf of what was caught
            lake.fill(BERRY, (2 + 3 * berry, 1, 2, 2))
        for miss in range(self.missed):
            lake.fill(CRACK, (2 + 3 * miss, 4, 2, 2))
        for life in range(max(0, self.lives)):
            lake.fill(SCARF, (62 + 6 * life, 1, 4, 4))
        lake.fill(SNOW, (76, 1, 2 + int(self.breath / BREATH * 5), 2))
        lake.fill(SNOW, (36, 4, int(24 * (1 - self.steps / MAX_STEPS)), 2))
        return np.ascontiguousarray(pygame.surfarray.array3d(lake).swapaxes(0, 1))

    def _draw_things(self, lake):
        for thing in self.falling:
            x, y = round(self.fall_x(thing)), round(thing[1])
            if thing[3]:
                pygame.draw.ellipse(lake, SEAL, (x - 3, y - 2, 7, 5))
                lake.fill(SEAL_DARK, (x + 2, y - 1, 1, 1))
            else:
                lake.fill(LEAF, (x, y - 3, 1, 2))
                pygame.draw.circle(lake, BERRY, (x, y), 2)
                lake.fill(BERRY_LIGHT, (x - 1, y - 1, 1, 1))
        for x, way in self.crawling:
            pygame.draw.ellipse(lake, SEAL_DARK, (round(x) - 4, ICE_Y - 4, 8, 4))
            lake.fill(SNOW, (round(x) + 3 * way, ICE_Y - 4, 1, 1))
        pygame.draw.circle(lake, BALL, (round(self.ball[0]), round(self.ball[1])), BALL_R)

    def _draw_skater(self, lake):
        if self.grace and self.steps % 4 < 2:
            return
        x, top = round(self.x), ICE_Y - SKATER_H
        lake.fill(COAT, (x + 1, top + 3, SKATER_W - 2, 5))
        lake.fill(SKIN, (x + 1, top, 4, 3))
        lake.fill(SCARF, (x + (0 if self.facing > 0 else 3), top + 3, 3, 1))
        lake.fill(SEAL_DARK, (x, ICE_Y - 1, SKATER_W, 1))
        lake.fill(BASKET, (x - 1, top - 2, SKATER_W + 2, 2))
        for berry in range(min(self.basket, FULL)):
            lake.fill(BERRY, (x - 1 + 2 * berry, top - 3, 1, 1))

    def render(self):
        return self._draw()
