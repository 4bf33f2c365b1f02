"""Dinosaur Valley: stack fossils with a crane while a mortar shells the stack and a balloon has to be kept aloft."""

import math
import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

import gymnasium as gym
import numpy as np
import pygame
from gymnasium import spaces

SIZE = 84
GROUND = 76
MAX_STEPS = 900
LIVES = 4

# fossils: width and height in pixels
FOSSILS = {"skull": (12, 7), "rib cage": (16, 6), "femur": (14, 5), "egg": (10, 7)}
BASE_X, BASE_HALF = 26, 11
HEIGHT_GOAL = 28
SWAY = 2.0

TROLLEY_SPEED = 2
TROLLEY_RANGE = (8, 76)
HOOK_RANGE = (14, 58)
HOOK_SPEED = 2
FALL_SPEED = 3
NEXT_LOAD = 8

SHELLS = 7
RELOAD = 70
WARNING = 15
FLIGHT = 24
MORTAR = (80, 68)
ARC_HEIGHT = 46
HITS_TO_LOSE = 5

BALLOON_X = 60
BALLOON_RISE = 18
BALLOON_TOP = 18
AIRBORNE_BONUS = 1.5
RAPTOR_CHANCE = 0.006

SKY = (250, 172, 104)
SUN = (255, 214, 120)
HILL = (120, 92, 80)
FERN = (66, 122, 62)
FERN_DARK = (44, 90, 46)
TAR = (26, 24, 28)
BONE = (240, 232, 208)
BONE_SHADE = (196, 184, 156)
CRANE = (92, 64, 44)
HATCHLING = (120, 214, 90)
RAPTOR = (150, 50, 60)
BALLOON = (224, 58, 96)
SHELL = (20, 16, 20)
MARK = (255, 255, 255)


class GameEnv(gym.Env):
    """The hatchling in the crane.

    Left and right drive the trolley, up and down wind the hook, the first button lets go of the load. The hatchling
    rides on the hook: it bumps the balloon up from below, and the load that hangs under it can stop a shell.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
    # Fossils come out of a bag that holds one of each kind, so that their order follows the seed alone.
    bag: list = []

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        self.lives = LIVES
        self.won = self.lost = False
        self.trolley = float(self.np_random.integers(50, 70))
        self.hook = 20.0
        self.bag.clear()
        self.load = self._next_fossil()
        self.waiting = 0
        self.falling = None  # [x, y, width, height]
        self.stack = []  # [x, width, height] from the bottom
        self.raptor = False
        self.balloon = 30.0
        self.shells_left = SHELLS
        self.countdown = RELOAD
        self.target = None  # where the next shell comes down
        self.flight = None  # steps in the air
        self.hits = 0
        self.best = 0
        return self.render(), self._info()

    def _next_fossil(self):
        """Take the next fossil out of the bag, and fill the bag when it is empty."""
        if not self.bag:
            kinds = sorted(FOSSILS)
            self.bag.extend(kinds[i] for i in self.np_random.permutation(len(kinds)))
        return self.bag.pop()

    # ------------------------------------------------------------------ geometry

    def height(self):
        return sum(block[2] for block in self.stack)

    def sway_at(self, height):
        """How far the stack leans at a height, in pixels."""
        strength = SWAY * (2.0 if self.raptor else 1.0)
        return strength * min(height / HEIGHT_GOAL, 1.2) * math.sin(self.t * 0.09)

    def arc_point(self, part):
        """A point of the mortar's arc: `part` runs from 0 at the mortar to 1 at the target."""
        x = MORTAR[0] + (self.target[0] - MORTAR[0]) * part
        y = MORTAR[1] + (self.target[1] - MORTAR[1]) * part - ARC_HEIGHT * 4 * part * (1 - part)
        return x, y

    # ------------------------------------------------------------------ rules

    def step(self, action):
        move, release = int(action[0]), int(action[1])
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.t += 1
        self._drive(move)
        gain, loss = 0.0, 0.0
        if release and self.load is not None and self.falling is None:
            width, height = FOSSILS[self.load]
            self.falling = [self.trolley, self.hook + 4.0, width, height]
            self.load, self.waiting = None, NEXT_LOAD
        elif self.load is None and self.falling is None:
            self.waiting -= 1
            if self.waiting <= 0:
                self.load = self._next_fossil()
        gain += self._fall()
        gain += self._shoot()
        loss += self._float()
        if self.stack and not self.raptor and self.np_random.random() < RAPTOR_CHANCE:
            self.raptor = True
        reward = gain * AIRBORNE_BONUS if gain > 0 and self.balloon < GROUND else gain
        reward -= loss
        if self.lives <= 0 or self.hits >= HITS_TO_LOSE:
            self.lost = True
            reward -= 1.0
        elif self.shells_left == 0 and self.flight is None and self.height() >= HEIGHT_GOAL:
            self.won = True
            reward += 5.0
        terminated = self.won or self.lost
        truncated = not terminated and self.t >= MAX_STEPS
        return self.render(), float(reward), terminated, truncated, self._info()

    def _drive(self, move):
        if move == 3:
            self.trolley = max(TROLLEY_RANGE[0], self.trolley - TROLLEY_SPEED)
        elif move == 4:
            self.trolley = min(TROLLEY_RANGE[1], self.trolley + TROLLEY_SPEED)
        elif move == 1:
            self.hook = max(HOOK_RANGE[0], self.hook - HOOK_SPEED)
        elif move == 2:
            self.hook = min(HOOK_RANGE[1], self.hook + HOOK_SPEED)

    def _fall(self):
        if self.falling is None:
            return 0.0
        x, _, width, height = self.falling
        self.falling[1] += FALL_SPEED
        bottom = self.falling[1] + height
        top = GROUND - self.height()
        if self.stack:
            middle, half = self.stack[-1][0] + self.sway_at(self.height()), self.stack[-1][1] / 2
        else:
            middle, half = BASE_X, BASE_HALF
        if bottom >= top and abs(x - middle) <= half and bottom < top + FALL_SPEED + 2:
            self.stack.append([x - self.sway_at(self.height()), width, height])
            self.falling, self.raptor = None, False
            gained = max(0, self.height() - self.best)
            self.best = max(self.best, self.height())
            return 0.1 + 0.05 * gained
        if bottom >= GROUND:
            self.falling = None
            return -0.1
        return 0.0

    def _shoot(self):
        if self.flight is not None:
            return self._fly_shell()
        if self.shells_left and (self.stack or self.target):
            self.countdown -= 1
            if self.countdown == WARNING:
                number = int(self.np_random.integers(len(self.stack))) if self.stack else 0
                below = sum(block[2] for block in self.stack[:number])
                self.target = (float(self.stack[number][0]) if self.stack else BASE_X, GROUND - below - 3.0)
            elif self.countdown <= 0:
                self.flight = 0
                self.countdown = RELOAD
                self.shells_left -= 1
        return 0.0

    def _fly_shell(self):
        self.flight += 1
        x, y = self.arc_point(self.flight / FLIGHT)
        if self.load is not None:
            width, height = FOSSILS[self.load]
            if abs(x - self.trolley) <= width / 2 + 3 and abs(y - (self.hook + 4 + height / 2)) <= height / 2 + 3:
                self.load, self.waiting = None, NEXT_LOAD
                self.flight = self.target = None
                return 0.3
        if self.flight < FLIGHT:
            return 0.0
        struck = self._block_at(GROUND - y)
        self.flight = self.target = None
        if struck is None:
            return 0.0
        del self.stack[struck]
        self.hits += 1
        return -0.4

    def _block_at(self, height):
        below = 0
        for number, block in enumerate(self.stack):
            if below <= height < below + block[2]:
                return number
            below += block[2]
        return None

    def _float(self):
        self.balloon += 0.5
        if abs(self.trolley - BALLOON_X) <= 5 and 0 <= self.hook - self.balloon <= 5:
            self.balloon = max(BALLOON_TOP, self.balloon - BALLOON_RISE)
        if self.balloon >= GROUND:
            self.balloon = 30.0
            self.lives -= 1
            return 1.0
        return 0.0

    def _info(self):
        return {
            "is_success": self.won,
            "height": self.height(),
            "shells_left": self.shells_left,
            "hits": self.hits,
            "lives": self.lives,
        }

    # ------------------------------------------------------------------ picture

    def render(self):
        canvas = pygame.Surface((SIZE, SIZE))
        canvas.fill(SKY)
        pygame.draw.circle(canvas, SUN, (14, 22), 9)
        pygame.draw.polygon(canvas, HILL, [(40, GROUND), (58, 44), (64, 44), (84, GROUND)])
        pygame.draw.rect(canvas, FERN, (0, GROUND, SIZE, 8))
        for x in range(2, SIZE, 7):
            pygame.draw.line(canvas, FERN_DARK, (x, GROUND - 1), (x + 2, GROUND - 4))
        pygame.draw.ellipse(canvas, TAR, (40, GROUND + 1, 24, 5))
        pygame.draw.rect(canvas, TAR, (BASE_X - BASE_HALF, GROUND - 1, 2 * BASE_HALF + 1, 2))
        for x in range(4, 48, 4):
            canvas.fill(MARK, (x, GROUND - HEIGHT_GOAL, 2, 1))
        self._draw_stack(canvas)
        pygame.draw.circle(canvas, TAR, MORTAR, 4)
        if self.target is not None:
            for k in range(2, 24):
                x, y = self.arc_point(k / 24)
                canvas.fill(MARK, (int(x), int(y), 1, 1))
        if self.flight is not None:
            pygame.draw.circle(canvas, SHELL, self.arc_point(self.flight / FLIGHT), 2)
        pygame.draw.line(canvas, BONE, (BALLOON_X, self.balloon), (BALLOON_X, self.balloon + 5))
        pygame.draw.circle(canvas, BALLOON, (BALLOON_X, self.balloon - 2), 4)
        self._draw_crane(canvas)
        if self.falling is not None:
            self._draw_fossil(canvas, *self.falling)
        self._draw_counts(canvas)
        return np.ascontiguousarray(pygame.surfarray.array3d(canvas).swapaxes(0, 1))

    def _draw_stack(self, canvas):
        below = 0
        for x, width, height in self.stack:
            lean = self.sway_at(below)
            self._draw_fossil(canvas, x + lean, GROUND - below - height, width, height)
            below += height
        if self.raptor and self.stack:
            x = self.stack[-1][0] + self.sway_at(below)
            pygame.draw.polygon(canvas, RAPTOR, [(x - 4, GROUND - below), (x, GROUND - below - 6), (x + 4, GROUND - below)])

    def _draw_fossil(self, canvas, x, y, width, height):
        box = pygame.Rect(round(x - width / 2), round(y), width, height)
        pygame.draw.rect(canvas, BONE, box, border_radius=2)
        pygame.draw.rect(canvas, BONE_SHADE, box, width=1, border_radius=2)

    def _draw_crane(self, canvas):
        pygame.draw.rect(canvas, CRANE, (0, 8, SIZE, 2))
        pygame.draw.rect(canvas, TAR, (self.trolley - 4, 7, 8, 4))
        pygame.draw.line(canvas, TAR, (self.trolley, 11), (self.trolley, self.hook))
        pygame.draw.circle(canvas, HATCHLING, (self.trolley, self.hook), 3)
        canvas.fill(TAR, (self.trolley + 1, self.hook - 1, 1, 1))
        if self.load is not None:
            self._draw_fossil(canvas, self.trolley, self.hook + 4, *FOSSILS[self.load])

    def _draw_counts(self, canvas):
        canvas.fill(TAR, (0, 0, SIZE, 5))
        for k in range(self.lives):
            canvas.fill(HATCHLING, (2 + 5 * k, 1, 4, 3))
        for k in range(self.shells_left):
            canvas.fill(MARK, (28 + 3 * k, 2, 2, 2))
        for k in range(self.hits):
            canvas.fill(BALLOON, (SIZE - 5 - 5 * k, 1, 4, 3))
