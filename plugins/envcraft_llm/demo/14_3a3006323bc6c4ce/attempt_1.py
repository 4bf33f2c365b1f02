"""Deep-sea Trench: a submersible climbs a narrow shaft from wall to wall and brings five nodules of ore to its ship.

It clings to what it touches and slips slowly; kicking off throws it across in an arc. Breath lasts 140 steps and is
filled at warm vents or at the ship. Small, it fits into burrows; large, it tramples the violet anglerfish. The cyan
ones are knocked out by thrown mussel banks only.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

W = H = 84
SHAFT_LEFT, SHAFT_RIGHT = 24, 60  # 36 pixels wide
SHIP_Y, BOTTOM_Y = 14, 80
LARGE, SMALL = 10, 5
CHANGE_STEPS, MOST_CHANGES = 4, 14
SLIP_EVERY = 2
ARC = 18
CROSSING = 1.6  # pixels a step sideways after a kick
GRAVITY = 0.09
KICK = float(np.sqrt(2 * GRAVITY * ARC))
STEER = 0.25
SINK = 1.4

ORE, CARRY = 5, 2
BREATH, FILL_STEPS, VENT_CLOSED = 140, 10, 80
FISH_EVERY, MOST_FISH = 40, 3
FISH_SPEED = 0.4
THROW_REACH, REGROW = 36, 80
LIVES, GRACE = 4, 35
MAX_STEPS = 950
FLASH_STEPS = 4

ABYSS, ROCK, ROCK_EDGE = (4, 8, 20), (30, 34, 48), (52, 58, 76)
SURFACE = (14, 40, 70)
HULL, HULL_DARK, PORTHOLE = (250, 210, 60), (190, 140, 30), (150, 240, 255)
CYAN, VIOLET, LURE = (40, 220, 230), (170, 90, 220), (255, 255, 190)
ORE_INK, BURROW = (255, 150, 60), (8, 8, 10)
MUSSEL, SPIKE = (80, 110, 200), (214, 220, 230)
VENT_OPEN, VENT_SHUT = (240, 60, 40), (90, 40, 40)
SHIP = (200, 206, 214)
HURT = np.array((255, 30, 30))


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (H, W, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        rng = self.np_random
        self.steps = self.changes = self.delivered = self.carrying = 0
        self.size = LARGE
        self.changing = 0
        self.side = -1  # -1 clings to the left wall, 1 to the right one, 0 drifts
        self.facing = 1
        self.x, self.y = float(SHAFT_LEFT + LARGE / 2), 24.0
        self.vx = self.vy = 0.0
        self.breath = float(BREATH)
        self.lives, self.grace, self.flash = LIVES, GRACE, 0
        self.fish = []  # [x, y, direction, kind]: kind 0 is cyan, 1 violet
        self.held = False
        self.shot = None  # [x, y, direction, pixels left]
        self.button_was = [0, 0]
        self.won = False

        # Each wall is a column of slots nine pixels high; what lies in one keeps all else out of it.
        slots = {side: [26 + 9 * k for k in rng.permutation(6).tolist()] for side in (-1, 1)}
        self.nodules = [[-1, slots[-1].pop(), False], [1, slots[1].pop(), False], [-1, slots[-1].pop(), False]]
        self.nodules += [[1, slots[1].pop(), True], [-1, slots[-1].pop(), True]]  # True: inside a burrow
        self.vents = [[1, slots[1].pop(), 0], [-1, slots[-1].pop(), 0], [1, slots[1].pop(), 0]]
        self.mussels = [[1, slots[1].pop(), 0]]
        self.spikes = [[-1, slots[-1].pop()], [1, slots[1].pop()]]
        self.backdrop = self._paint_backdrop()
        return self._frame(), self._info()

    # ---- step ------------------------------------------------------------------------------------------------------

    def step(self, action):
        move, grab, resize = int(action[0]), int(action[1]), int(action[2])
        self.steps += 1
        reward = 0.0
        lost = self.lives <= 0 or self.changes >= MOST_CHANGES
        if not (self.won or lost):
            self.grace, self.flash = max(0, self.grace - 1), max(0, self.flash - 1)
            if resize and not self.button_was[1] and not self.changing:
                self.changing = CHANGE_STEPS
            if self.changing:
                self._change_size()
            else:
                self._swim(move)
            if grab and not self.button_was[0]:
                self._grab_or_throw()
            self.button_was = [grab, resize]
            reward += self._fly_shot() + self._move_fish() + self._touch_walls() + self._breathe() + self._collect()
            self.won = self.delivered == ORE
            reward += 5.0 * self.won
            lost = self.lives <= 0 or self.changes >= MOST_CHANGES
            if lost and not self.won:
                reward -= 1.0
        terminated = bool(self.won or lost)
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._frame(), float(reward), terminated, truncated, self._info()

    def _change_size(self):
        self.changing -= 1
        if self.changing == 0:
            self.size = SMALL if self.size == LARGE else LARGE
            self.changes += 1
            self._keep_inside()

    def _keep_inside(self):
        half = self.size / 2
        if self.side:
            self.x = SHAFT_LEFT + half if self.side < 0 else SHAFT_RIGHT - half
        self.x = float(np.clip(self.x, SHAFT_LEFT + half, SHAFT_RIGHT - half))
        if self.y > BOTTOM_Y - half:
            self.y, self.vy = BOTTOM_Y - half, 0.0
        if self.y < SHIP_Y - 4 + half:
            self.y, self.vy = SHIP_Y - 4 + half, max(self.vy, 0.0)

    def _swim(self, move):
        if self.side:
            if self.steps % SLIP_EVERY == 0:
                self.y += 1.0
            if move == 1:
                self.vx, self.vy = -self.side * CROSSING, -KICK
                self.facing, self.side = -self.side, 0
            elif move == 2:
                self.vx, self.vy = -self.side * 0.4, 0.4
                self.side = 0
        else:
            if move in (3, 4):
                way = -1 if move == 3 else 1
                self.facing = way
                self.vx = float(np.clip(self.vx + STEER * way, -CROSSING, CROSSING))
            self.vy = min(self.vy + GRAVITY, SINK)
            self.x += self.vx
            self.y += self.vy
            half = self.size / 2
            if self.x <= SHAFT_LEFT + half and self.vx < 0:
                self.side = -1
            elif self.x >= SHAFT_RIGHT - half and self.vx > 0:
                self.side = 1
        self._keep_inside()

    def _hurt(self):
        if self.grace:
            return 0.0
        self.lives -= 1
        self.grace, self.flash = GRACE, FLASH_STEPS
        return -1.0

    def _beside(self, thing, reach):
        return self.side == thing[0] and abs(self.y - thing[1] - 4) <= reach

    def _grab_or_throw(self):
        if self.held:
            self.held = False
            self.shot = [self.x, self.y, self.facing, THROW_REACH]
            return
        for mussel in self.mussels:
            if mussel[2] == 0 and self._beside(mussel, self.size / 2 + 3):
                mussel[2] = REGROW
                self.held = True
                return

    def _fly_shot(self):
        for mussel in self.mussels:
            mussel[2] = max(0, mussel[2] - 1)
        if self.shot is None:
            return 0.0
        self.shot[0] += 3.0 * self.shot[2]
        self.shot[3] -= 3
        struck = [fish for fish in self.fish if abs(fish[0] - self.shot[0]) < 5 and abs(fish[1] - self.shot[1]) < 5]
        if struck or self.shot[3] <= 0 or not SHAFT_LEFT < self.shot[0] < SHAFT_RIGHT:
            self.shot = None
        self.fish = [fish for fish in self.fish if fish not in struck]
        return 0.5 * len(struck)

    def _move_fish(self):
        if self.steps % FISH_EVERY == 0 and len(self.fish) < MOST_FISH:
            y = float(self.np_random.integers(30, 74))
            side = 1 if self.np_random.integers(2) else -1
            self.fish.append([42.0 - 14 * side, y, side, int(self.np_random.integers(2))])
        reward = 0.0
        for fish in list(self.fish):
            fish[0] += FISH_SPEED * fish[2]
            if not SHAFT_LEFT + 4 < fish[0] < SHAFT_RIGHT - 4:
                fish[2] = -fish[2]
            reach = self.size / 2 + 2
            if abs(fish[0] - self.x) < reach and abs(fish[1] - self.y) < reach:
                if fish[3] == 1 and self.size == LARGE:
                    self.fish.remove(fish)
                    reward += 0.2
                else:
                    reward += self._hurt()
        return reward

    def _touch_walls(self):
        if any(self._beside(strip, self.size / 2 + 2) for strip in self.spikes):
            return self._hurt()
        return 0.0

    def _breathe(self):
        self.breath -= 1.0
        filling = self.y < SHIP_Y + 6
        for vent in self.vents:
            vent[2] = max(0, vent[2] - 1)
            if vent[2] == 0 and self._beside(vent, self.size / 2 + 3):
                filling = True
                if self.breath > BREATH - 15:
                    vent[2] = VENT_CLOSED
        if filling:
            self.breath = min(float(BREATH), self.breath + 1 + BREATH / FILL_STEPS)
        if self.breath <= 0:
            self.breath = float(BREATH)
            self.grace = 0
            return self._hurt()
        return 0.0

    def _collect(self):
        reward = 0.0
        for nodule in list(self.nodules):
            fits = self.size == SMALL or not nodule[2]
            if fits and self.carrying < CARRY and self._beside(nodule, self.size / 2 + 2):
                self.nodules.remove(nodule)
                self.carrying += 1
                reward += 0.5
        if self.carrying and self.y < SHIP_Y + 6:
            reward += float(self.carrying)
            self.delivered += self.carrying
            self.carrying = 0
        return reward

    def _info(self):
        return {
            "is_success": bool(self.won),
            "delivered": self.delivered,
            "lives": self.lives,
            "breath": self.breath,
            "changes": self.changes,
        }

    # ---- picture ---------------------------------------------------------------------------------------------------

    def _paint_backdrop(self):
        img = np.empty((H, W, 3), np.uint8)
        depth = np.linspace(1.0, 0.15, H)[:, None]
        img[:] = (np.array(SURFACE) * depth + np.array(ABYSS) * (1 - depth)).astype(np.uint8)[:, None]
        img[8:, :SHAFT_LEFT] = img[8:, SHAFT_RIGHT:] = ROCK
        for y, x in self.np_random.integers((10, 0), (H, W), size=(60, 2)).tolist():
            if not SHAFT_LEFT - 3 <= x < SHAFT_RIGHT + 3:
                img[y : y + 2, x : x + 3] = ROCK_EDGE
        img[BOTTOM_Y:] = ROCK
        img[8:10, 20:64] = SHIP
        img[5:8, 28:56] = SHIP
        for side, y in self.spikes:
            for tooth in range(0, 8, 2):
                left = SHAFT_LEFT if side < 0 else SHAFT_RIGHT - 3
                img[y + tooth, left : left + 3] = SPIKE
        return img

    def _at_wall(self, img, side, y, ink, depth, inside=0):
        left = SHAFT_LEFT - depth + inside if side < 0 else SHAFT_RIGHT - inside
        img[y + 1 : y + 8, left : left + depth] = ink

    def _frame(self):
        img = self.backdrop.copy()
        for side, y, burrowed in self.nodules:
            if burrowed:
                self._at_wall(img, side, y, BURROW, 7)
            left = SHAFT_LEFT - 5 if side < 0 else SHAFT_RIGHT + 1
            img[y + 3 : y + 7, left : left + 4] = ORE_INK
        for side, y, shut in self.vents:
            self._at_wall(img, side, y, VENT_SHUT if shut else VENT_OPEN, 3)
        for side, y, gone in self.mussels:
            if not gone:
                self._at_wall(img, side, y, MUSSEL, 5, 2)
        for x, y, way, kind in self.fish:
            col, row = int(x), int(y)
            img[row - 2 : row + 3, col - 3 : col + 3] = VIOLET if kind else CYAN
            img[row - 3, col + 3 * way] = LURE
        if self.shot is not None:
            col, row = int(self.shot[0]), int(self.shot[1])
            img[row - 1 : row + 2, col - 1 : col + 2] = MUSSEL
        half = self.size // 2
        col, row = int(self.x), int(self.y)
        img[row - half : row + half + 1, col - half : col + half + 1] = HULL_DARK if self.changing else HULL
        img[row - 1 : row + 1, col + self.facing : col + self.facing + 2] = PORTHOLE
        if self.held:
            img[row - half - 2 : row - half, col - 1 : col + 2] = MUSSEL
        for ore in range(self.carrying):
            img[row + half, col - 2 + 3 * ore : col + 3 * ore] = ORE_INK
        img[82:84, : int(W * self.breath / BREATH)] = CYAN
        for life in range(self.lives):
            img[1:4, 2 + 5 * life : 5 + 5 * life] = HULL
        for ore in range(self.delivered):
            img[1:4, 79 - 5 * ore : 82 - 5 * ore] = ORE_INK
        img[1:3, 28 : 28 + 2 * (MOST_CHANGES - self.changes)] = VIOLET
        if self.flash:
            img = (img * 0.6 + HURT * 0.4).astype(np.uint8)
        return img

    def render(self):
        return self._frame()
