"""Mountain Monastery: a pinball table in a courtyard garden.

The novice is the ball. The bumpers are plants: four hits make one bear a bell, and rolling over the bell harvests it.
A plant that nothing touches for 220 steps withers to a stump, which throws the ball in odd directions until three
hits have revived it. From a corner that keeps changing, fans of five slow petals of light spread over the table; a
hit costs a life, and so does draining between the flippers. Five bells win.

Button one lifts the left flipper, button two the right one; left and right nudge the table, but not too often.
"""

import math
from functools import cache

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
TOP = 7
LIMIT = 950
LIVES = 2
BELLS = 5

BALL = 2.0
GRAVITY = 0.11
FASTEST = 4.5
SUBSTEPS = 3

PIVOTS = ((22.0, 73.0), (62.0, 73.0))
FLIPPER_LENGTH = 18.5
FLIPPER_DOWN, FLIPPER_UP = math.radians(28), math.radians(-28)
FLIPPER_KICK = 4.0
WALL_LINES = (((3.0, 60.0), PIVOTS[0]), ((81.0, 60.0), PIVOTS[1]))

NUDGES, NUDGE_WINDOW, TILT_STEPS = 4, 100, 60

BUMPERS = ((33.0, 27.0), (51.0, 27.0), (42.0, 38.0), (42.0, 17.0))
BUMPER_RADIUS = 4.5
BUMPER_KICK = 3.3
WATERS, DRY, REVIVE = 4, 220, 3
LAMPS = ((12, 40), (72, 40), (42, 56))
RAMP = (76, 18)

CORNERS = ((4.0, 10.0), (80.0, 10.0), (80.0, 58.0), (4.0, 58.0))
CORNER_SPAN = 60
VOLLEY = 40
FAN = 5
BULLET_SPEED = 0.55
BULLET_LIFE = 46

STONE = (112, 106, 104)
STONE_DARK = (92, 86, 86)
MIST = (224, 226, 230)
FLAG_RED = (196, 48, 52)
SAFFRON = (244, 172, 48)
PLANT = (70, 130, 70)
PLANT_DRY = (120, 104, 70)
STUMP = (76, 58, 46)
BELL = (255, 226, 120)
LAMP_OFF = (70, 60, 66)
RAMP_SHUT = (60, 52, 60)
PETAL = (255, 120, 190)
ROBE = (150, 40, 60)


@cache
def courtyard():
    """The table without anything on it, drawn once."""
    table = pygame.Surface((SIZE, SIZE))
    table.fill(STONE)
    for row in range(TOP + 8, SIZE, 12):
        table.fill(STONE_DARK, (3, row, SIZE - 6, 1))
    for column in range(3, SIZE, 13):
        table.fill(STONE_DARK, (column, TOP, 1, SIZE))
    table.fill(MIST, (0, SIZE - 5, SIZE, 5))
    table.fill(ROBE, (0, TOP, 3, SIZE))
    table.fill(ROBE, (SIZE - 3, TOP, 3, SIZE))
    table.fill((30, 24, 30), (0, 0, SIZE, TOP - 1))
    for start, end in WALL_LINES:
        pygame.draw.line(table, ROBE, start, end, 2)
    return table


class GameEnv(gym.Env):
    """Water the plants by running into them."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.harvested = 0
        self.plants = [{"hits": 0, "dry": 0, "stump": 0, "rest": 0} for _ in BUMPERS]
        self.lamps = [False] * len(LAMPS)
        self.lifted = [0.0, 0.0]
        self.rising = [False, False]
        self.nudged = []
        self.tilt = 0
        self.bullets = []
        self.corner = int(self.np_random.integers(len(CORNERS)))
        self.safe = 0
        self.lost = False
        self._serve()
        return self._picture(), self._info()

    def _serve(self):
        self.x = float(self.np_random.uniform(36, 48))
        self.y = 11.0
        self.vx = float(self.np_random.uniform(0.4, 0.9)) * (1 if self.np_random.random() < 0.5 else -1)
        self.vy = 0.0
        self.safe = 90

    # -- rules -----------------------------------------------------------------

    def step(self, action):
        reward = 0.0
        if not self._over():
            self.steps += 1
            self.safe = max(0, self.safe - 1)
            self._nudge(int(action[0]))
            self._lift(int(action[1]), int(action[2]))
            for _ in range(SUBSTEPS):
                reward += self._roll(1.0 / SUBSTEPS)
            reward += self._tend_garden() + self._light_lamps() + self._rain() + self._drain()
            if self._over():
                reward += 5.0 if self.harvested >= BELLS else -1.0
        terminated = self._over()
        truncated = self.steps >= LIMIT and not terminated
        return self._picture(), float(reward), terminated, truncated, self._info()

    def _over(self):
        return self.harvested >= BELLS or self.lives <= 0 or all(plant["stump"] for plant in self.plants)

    def _nudge(self, move):
        self.tilt = max(0, self.tilt - 1)
        if move not in (3, 4):
            return
        self.nudged = [step for step in self.nudged if self.steps - step < NUDGE_WINDOW] + [self.steps]
        if len(self.nudged) > NUDGES:
            self.tilt = TILT_STEPS
            self.nudged = []
            return
        if not self.tilt:
            push = 1.0 if move == 4 else -1.0
            self.x = min(max(self.x + push, 4.0), SIZE - 4.0)
            self.vx += 0.2 * push

    def _lift(self, left, right):
        """Flippers swing up at once and fall in three steps; a tilted table does not answer."""
        for side, pressed in enumerate((left, right)):
            before = self.lifted[side]
            wanted = 1.0 if pressed and not self.tilt else 0.0
            change = 1.0 if wanted > before else -0.34
            self.lifted[side] = min(max(before + change, 0.0), 1.0) if wanted != before else before
            self.rising[side] = self.lifted[side] > before

    def flipper(self, side):
        """The two ends of a flipper as it lies now."""
        angle = FLIPPER_DOWN + (FLIPPER_UP - FLIPPER_DOWN) * self.lifted[side]
        px, py = PIVOTS[side]
        way = 1 if side == 0 else -1
        return (px, py), (px + way * FLIPPER_LENGTH * math.cos(angle), py + FLIPPER_LENGTH * math.sin(angle))

    def _roll(self, share):
        self.vy += GRAVITY * share
        speed = math.hypot(self.vx, self.vy)
        if speed > FASTEST:
            self.vx *= FASTEST / speed
            self.vy *= FASTEST / speed
        self.x += self.vx * share
        self.y += self.vy * share
        if self.x < 3 + BALL or self.x > SIZE - 3 - BALL:
            self.x = min(max(self.x, 3 + BALL), SIZE - 3 - BALL)
            self.vx *= -0.8
        if self.y < TOP + BALL:
            self.y = TOP + BALL
            self.vy = abs(self.vy) * 0.8
        for start, end in WALL_LINES:
            self._bounce_off_line(start, end, 0.3)
        for side in (0, 1):
            self._hit_flipper(side)
        return self._hit_bumpers()

    def _nearest(self, start, end):
        """The normal from a line to the ball, and its length."""
        ex, ey = end[0] - start[0], end[1] - start[1]
        along = ((self.x - start[0]) * ex + (self.y - start[1]) * ey) / (ex * ex + ey * ey)
        along = min(max(along, 0.0), 1.0)
        nx, ny = self.x - start[0] - along * ex, self.y - start[1] - along * ey
        return nx, ny, math.hypot(nx, ny)

    def _bounce_off_line(self, start, end, spring):
        nx, ny, gap = self._nearest(start, end)
        if gap >= BALL or gap == 0:
            return
        nx, ny = nx / gap, ny / gap
        if ny > 0:
            # From below: back on top of it.
            nx, ny, gap = -nx, -ny, -gap
        self.x += nx * (BALL - gap)
        self.y += ny * (BALL - gap)
        into = self.vx * nx + self.vy * ny
        if into < 0:
            self.vx -= (1 + spring) * into * nx
            self.vy -= (1 + spring) * into * ny

    def _hit_flipper(self, side):
        if self.rising[side] and self._sweep(side):
            return
        start, end = self.flipper(side)
        self._bounce_off_line(start, end, 0.2)

    def _sweep(self, side):
        """Throw the ball if it lies where the rising flipper passes; it ends above the lifted flipper."""
        (px, py), way = PIVOTS[side], 1 if side == 0 else -1
        dx, dy = way * (self.x - px), self.y - py
        distance, angle = math.hypot(dx, dy), math.atan2(dy, dx)
        margin = math.asin(min(1.0, (BALL + 1) / max(distance, BALL + 1)))
        if not 2 < distance < FLIPPER_LENGTH + 1 or not FLIPPER_UP - margin < angle < FLIPPER_DOWN + margin:
            return False
        along = distance / FLIPPER_LENGTH
        lifted = FLIPPER_UP - margin
        self.x, self.y = px + way * distance * math.cos(lifted), py + distance * math.sin(lifted)
        # The further out on the flipper, the harder, and the more across the table.
        self.vx = way * (2.2 - 2.4 * along)
        self.vy = -FLIPPER_KICK * (0.7 + 0.35 * along)
        self.rising[side] = False
        return True

    def _hit_bumpers(self):
        reward = 0.0
        for plant, (bx, by) in zip(self.plants, BUMPERS):
            dx, dy = self.x - bx, self.y - by
            gap = math.hypot(dx, dy)
            if gap >= BUMPER_RADIUS + BALL or gap == 0:
                continue
            if plant["hits"] >= WATERS and not plant["stump"]:
                plant.update(hits=0, dry=0, rest=12)
                self.harvested += 1
                reward += 2.0
                continue
            if plant["rest"] > 8:
                # The ball is still rolling away from the bell it has just taken.
                continue
            nx, ny = dx / gap, dy / gap
            if plant["stump"]:
                turn = float(self.np_random.uniform(-1.2, 1.2))
                nx, ny = nx * math.cos(turn) - ny * math.sin(turn), nx * math.sin(turn) + ny * math.cos(turn)
            self.x, self.y = bx + dx / gap * (BUMPER_RADIUS + BALL), by + dy / gap * (BUMPER_RADIUS + BALL)
            self.vx, self.vy = nx * BUMPER_KICK, ny * BUMPER_KICK
            if not plant["rest"]:
                reward += self._water(plant)
        return reward

    @staticmethod
    def _water(plant):
        plant["rest"], plant["dry"] = 4, 0
        if plant["stump"]:
            plant["stump"] -= 1
            return 0.05
        plant["hits"] += 1
        return 0.2

    def _tend_garden(self):
        for plant in self.plants:
            plant["rest"] = max(0, plant["rest"] - 1)
            plant["dry"] += 1
            if plant["dry"] >= DRY and not plant["stump"]:
                plant["stump"], plant["hits"] = REVIVE, 0
        return 0.0

    def _light_lamps(self):
        for number, (lx, ly) in enumerate(LAMPS):
            if abs(self.x - lx) < 4 and abs(self.y - ly) < 4:
                self.lamps[number] = True
        if all(self.lamps) and abs(self.x - RAMP[0]) < 4 and abs(self.y - RAMP[1]) < 5:
            self.lamps = [False] * len(LAMPS)
            for plant in self.plants:
                plant["dry"] = 0
            return 0.5
        return 0.0

    def _rain(self):
        if self.steps % CORNER_SPAN == 0:
            self.corner = (self.corner + 1 + int(self.np_random.integers(3))) % len(CORNERS)
        if self.steps % VOLLEY == 0:
            cx, cy = CORNERS[self.corner]
            aim = math.atan2(40 - cy, 42 - cx)
            for number in range(FAN):
                angle = aim + 0.25 * (number - FAN // 2)
                vx, vy = BULLET_SPEED * math.cos(angle), BULLET_SPEED * math.sin(angle)
                self.bullets.append([cx, cy, vx, vy, BULLET_LIFE])
        hit = False
        for bullet in self.bullets:
            bullet[0] += bullet[2]
            bullet[1] += bullet[3]
            bullet[4] -= 1
            if not self.safe and abs(bullet[0] - self.x) < 1.5 and abs(bullet[1] - self.y) < 1.5:
                hit = True
                bullet[4] = 0
        self.bullets = [bullet for bullet in self.bullets if bullet[4] > 0]
        if not hit:
            return 0.0
        self.lives -= 1
        self.safe = 90
        return -1.0

    def _drain(self):
        if self.y < SIZE - 1:
            return 0.0
        self.lives -= 1
        self._serve()
        return -1.0

    def _info(self):
        return {"is_success": self.harvested >= BELLS, "bells": self.harvested, "lives": self.lives}

    # -- picture ---------------------------------------------------------------

    def render(self):
        return self._picture()

    def _picture(self):
        table = courtyard().copy()
        for number in range(12):
            colour = (FLAG_RED, SAFFRON, MIST)[number % 3]
            sway = (self.steps // 8 + number) % 2
            table.fill(colour, (4 + 7 * number, TOP, 4, 2 + sway))
        for (lx, ly), lit in zip(LAMPS, self.lamps):
            pygame.draw.circle(table, SAFFRON if lit else LAMP_OFF, (lx, ly), 2)
        table.fill(SAFFRON if all(self.lamps) else RAMP_SHUT, (RAMP[0] - 2, RAMP[1] - 4, 5, 9))
        self._draw_plants(table)
        for side in (0, 1):
            start, end = self.flipper(side)
            pygame.draw.line(table, STONE_DARK if self.tilt else SAFFRON, start, end, 3)
        for bx, by, *_ in self.bullets:
            table.fill(PETAL, (int(bx) - 1, int(by) - 1, 2, 2))
        cx, cy = CORNERS[self.corner]
        table.fill(PETAL, (int(cx) - 2, int(cy) - 2, 4, 4))
        if self.safe % 6 < 4:
            pygame.draw.circle(table, MIST, (self.x, self.y), 2)
            table.set_at((int(self.x), int(self.y)), ROBE)
        self._draw_counts(table)
        return np.ascontiguousarray(pygame.surfarray.array3d(table).swapaxes(0, 1))

    def _draw_plants(self, table):
        for plant, place in zip(self.plants, BUMPERS):
            if plant["stump"]:
                pygame.draw.circle(table, STUMP, place, BUMPER_RADIUS)
                pygame.draw.circle(table, PLANT_DRY, place, plant["stump"] - 1)
            elif plant["hits"] >= WATERS:
                pygame.draw.circle(table, BELL, place, 3)
                table.fill(FLAG_RED, (int(place[0]), int(place[1]) + 2, 1, 2))
            else:
                pygame.draw.circle(table, PLANT if plant["dry"] < DRY - 70 else PLANT_DRY, place, BUMPER_RADIUS)
                for drop in range(plant["hits"]):
                    table.fill(MIST, (int(place[0]) - 3 + 2 * drop, int(place[1]), 1, 2))

    def _draw_counts(self, table):
        for life in range(self.lives):
            table.fill(MIST, (2 + 5 * life, 1, 4, 4))
        for bell in range(BELLS):
            table.fill(BELL if bell < self.harvested else LAMP_OFF, (30 + 6 * bell, 1, 4, 4))
        for nudge in range(NUDGES - min(len(self.nudged), NUDGES)):
            table.fill(SAFFRON, (66 + 4 * nudge, 2, 3, 2))
