"""Volcano Forge: roll the smith over a tilting forge floor and bring in fourteen fire-flowers.

The pad tilts the floor, the smith rolls on it like a marble. The first button sows a seed on bare ground, or harvests
the ripe flower underfoot. Lava imps eat ripe flowers and bite the small apprentice who trots after the smith; both
kinds turn back when the smith touches them. Three sentries with cones of sight raise an alarm.
"""

import math

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
RIM = 7  # width of the lava rim, in pixels
MAX_STEPS = 1000
LIVES = 2
HARVEST_GOAL = 14
RIM_LIMIT = 15

TILT = 0.12  # acceleration at 12 degrees of tilt, pixels per step squared
DRAG = 0.95
BOUNCE = 0.55
SMITH_RADIUS = 3
HOLES = 8
HOLE_RADIUS = 4
ANVILS = 5

RIPE_AGE = 50
ROT_AGE = 110
HARVEST_REACH = 4.0
SOW_SPACING = 6.0
ASH_STEPS = 400

IMP_GAP = 60
IMP_SPEED = 0.55
APPRENTICE_REACH = 30
APPRENTICE_SHARE = 0.5
APPRENTICE_BITES = 4

SENTRIES = 3
SIGHT = 24
HALF_CONE = math.radians(40)
ALARM_FULL = 40
HURRY_STEPS = 80

BASALT = (38, 36, 44)
BASALT_LIGHT = (46, 44, 54)
LAVA = (255, 110, 20)
LAVA_DARK = (190, 52, 10)
STEEL = (150, 160, 176)
EMBER = (224, 40, 40)
PALE = (92, 84, 84)
SPROUT = (90, 150, 60)
FLOWER = (255, 214, 60)
ROTTEN = (110, 78, 50)
ASH = (70, 68, 70)
SMITH = (240, 240, 250)
APPRENTICE = (110, 190, 255)

# Pixel offsets of every ray of a cone, for the four ways that a sentry can face.
RAYS = np.linspace(-HALF_CONE, HALF_CONE, 33)[:, None]
RANGE = np.arange(2, SIGHT)[None, :]
CONES = [
    (np.rint(np.cos(RAYS + k * np.pi / 2) * RANGE).astype(int), np.rint(np.sin(RAYS + k * np.pi / 2) * RANGE).astype(int))
    for k in range(4)
]


class GameEnv(gym.Env):
    """A marble smith, a garden, an apprentice and three sentries."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.harvested = 0
        self.rim_hits = 0
        self.bites = 0
        self.alarm = 0
        self.hurry = 0
        self.won = False
        self.lost = False
        self.x = self.y = 42.0
        # The floor is never quite level: the smith comes in with a little roll.
        self.vx, self.vy = (float(v) for v in self.np_random.uniform(-0.3, 0.3, size=2))
        self.friend_x, self.friend_y = 42.0, 52.0
        self.plants = []  # [x, y, age]
        self.ashes = []  # [x, y, steps left]
        self.imps = []  # dicts: x, y, prey, fleeing
        self._lay_floor()
        self._post_sentries()
        return self.render(), self._info()

    def _lay_floor(self):
        """Scatter holes and anvils, away from the middle and from each other."""
        spots = []
        while len(spots) < HOLES + ANVILS:
            x, y = (int(v) for v in self.np_random.integers(RIM + 6, SIZE - RIM - 6, size=2))
            clear = math.hypot(x - 42, y - 46) > 19
            if clear and all(math.hypot(x - a, y - b) > 11 for a, b in spots):
                spots.append((x, y))
            elif self.np_random.random() < 0.004:
                spots.clear()  # a layout with no room left is begun again
        self.holes = spots[:HOLES]
        self.anvils = spots[HOLES:]

        floor = np.empty((SIZE, SIZE, 3), np.uint8)
        floor[:] = BASALT
        ys, xs = np.indices((SIZE, SIZE))
        floor[((xs // 6) + (ys // 6)) % 2 == 0] = BASALT_LIGHT
        rim = (xs < RIM - 3) | (xs >= SIZE - RIM + 3) | (ys < RIM - 3) | (ys >= SIZE - RIM + 3)
        floor[rim] = LAVA_DARK
        floor[rim & ((xs * 5 + ys * 3) % 7 < 2)] = LAVA
        for hx, hy in self.holes:
            floor[(xs - hx) ** 2 + (ys - hy) ** 2 <= (HOLE_RADIUS + 1) ** 2] = LAVA_DARK
            floor[(xs - hx) ** 2 + (ys - hy) ** 2 <= (HOLE_RADIUS - 1) ** 2] = (12, 6, 6)
        self.solid = np.zeros((SIZE, SIZE), bool)
        for ax, ay in self.anvils:
            self.solid[ay - 2 : ay + 3, ax - 4 : ax + 5] = True
        floor[self.solid] = STEEL
        for ax, ay in self.anvils:
            floor[ay + 2, ax - 4 : ax + 5] = (90, 96, 110)
        self.floor = floor

    def _post_sentries(self):
        """Each sentry walks a small rectangle round a corner of the forge."""
        corners = [(20, 20), (64, 20), (20, 64), (64, 64)]
        order = self.np_random.permutation(4)[:SENTRIES]
        self.sentries = []
        for k in order:
            cx, cy = corners[int(k)]
            self.sentries.append({"cx": cx, "cy": cy, "phase": float(self.np_random.uniform(0, 80)), "x": cx, "y": cy,
                                  "facing": 0.0})
        self._walk_sentries()

    # ---------------------------------------------------------------- one step

    def step(self, action):
        move, sow = int(action[0]), int(action[1])
        if self.won or self.lost:
            return self.render(), 0.0, True, False, self._info()
        self.steps += 1
        reward = self._roll(move)
        reward += self._garden(bool(sow))
        reward += self._shaping()
        self._walk_friend()
        self._walk_sentries()
        reward += self._watch()
        reward += self._run_imps()
        if self.lives <= 0 or self.rim_hits >= RIM_LIMIT:
            self.lost = not self.won
        terminated = self.won or self.lost
        truncated = not terminated and self.steps >= MAX_STEPS
        return self.render(), float(reward), terminated, truncated, self._info()

    def _info(self):
        return {"is_success": self.won, "harvested": self.harvested, "lives": self.lives, "rim_hits": self.rim_hits}

    def _roll(self, move):
        self.vx = (self.vx + TILT * ((move == 4) - (move == 3))) * DRAG
        self.vy = (self.vy + TILT * ((move == 2) - (move == 1))) * DRAG
        self.x += self.vx
        self.y += self.vy
        reward = 0.0
        low, high = RIM, SIZE - 1 - RIM
        struck = False
        if not low <= self.x <= high:
            self.x = min(max(self.x, low), high)
            self.vx *= -BOUNCE
            struck = True
        if not low <= self.y <= high:
            self.y = min(max(self.y, low), high)
            self.vy *= -BOUNCE
            struck = True
        if struck:
            self.rim_hits += 1
            reward -= 0.1
        for ax, ay in self.anvils:
            if abs(self.x - ax) < 7 and abs(self.y - ay) < 5:
                if abs(self.x - ax) / 7 > abs(self.y - ay) / 5:
                    self.x = ax + math.copysign(7, self.x - ax)
                    self.vx *= -BOUNCE
                else:
                    self.y = ay + math.copysign(5, self.y - ay)
                    self.vy *= -BOUNCE
        if any((self.x - hx) ** 2 + (self.y - hy) ** 2 < (HOLE_RADIUS - 1) ** 2 for hx, hy in self.holes):
            reward += self._lose_life()
        return reward

    def _lose_life(self):
        self.lives -= 1
        self.x = self.y = 42.0
        self.vx = self.vy = 0.0
        return -1.0

    def _garden(self, sow):
        reward = 0.0
        for plant in self.plants:
            plant[2] += 1
        rotten = [p for p in self.plants if p[2] >= ROT_AGE]
        reward -= 0.1 * len(rotten)
        self.plants = [p for p in self.plants if p[2] < ROT_AGE]
        for ash in self.ashes:
            ash[2] -= 1
        self.ashes = [a for a in self.ashes if a[2] > 0]
        if not sow:
            return reward
        near = [p for p in self.plants if math.hypot(p[0] - self.x, p[1] - self.y) < HARVEST_REACH]
        ripe = [p for p in near if p[2] >= RIPE_AGE]
        if ripe:
            plant = ripe[0]
            self.plants.remove(plant)
            self.ashes.append([plant[0], plant[1], ASH_STEPS])
            self.harvested += 1
            reward += 1.0
            if self.harvested >= HARVEST_GOAL:
                self.won = True
                reward += 5.0
        elif self._bare(self.x, self.y):
            self.plants.append([self.x, self.y, 0])
        return reward

    def _bare(self, x, y):
        """Whether a seed can be sown here: no plant and no ash close by."""
        return all(math.hypot(p[0] - x, p[1] - y) >= SOW_SPACING for p in self.plants) and all(
            math.hypot(a[0] - x, a[1] - y) >= SOW_SPACING for a in self.ashes
        )

    def _shaping(self):
        """A hundredth for rolling straight towards the oldest plant: the cosine between velocity and direction."""
        if not self.plants:
            return 0.0
        px, py, _ = max(self.plants, key=lambda p: p[2])
        velocity = np.array([self.vx, self.vy])
        to_plant = np.array([px - self.x, py - self.y])
        distance = np.linalg.norm(to_plant)
        if distance < 1e-6:
            return 0.0
        return 0.01 * float(velocity @ to_plant / (np.linalg.norm(velocity) * distance))

    # ---------------------------------------------------------------- the others

    def _walk_friend(self):
        dx, dy = self.x - self.friend_x, self.y - self.friend_y
        distance = math.hypot(dx, dy)
        if 7 < distance <= APPRENTICE_REACH:
            pace = max(APPRENTICE_SHARE * math.hypot(self.vx, self.vy), 0.1)
            self.friend_x += pace * dx / distance
            self.friend_y += pace * dy / distance

    def _walk_sentries(self):
        for sentry in self.sentries:
            t = (self.steps * 0.25 + sentry["phase"]) % 80
            side, along = int(t // 20), t % 20 - 10
            sentry["x"], sentry["y"] = [
                (sentry["cx"] + along * 0.6, sentry["cy"] - 6),
                (sentry["cx"] + 6, sentry["cy"] + along * 0.6),
                (sentry["cx"] - along * 0.6, sentry["cy"] + 6),
                (sentry["cx"] - 6, sentry["cy"] - along * 0.6),
            ][side]
            sentry["facing"] = side * math.pi / 2

    def _sees(self, sentry):
        dx, dy = self.x - sentry["x"], self.y - sentry["y"]
        distance = math.hypot(dx, dy)
        if distance > SIGHT:
            return False
        off = (math.atan2(dy, dx) - sentry["facing"] + math.pi) % (2 * math.pi) - math.pi
        if abs(off) > HALF_CONE:
            return False
        return not any(
            self.solid[int(sentry["y"] + dy * k / 8), int(sentry["x"] + dx * k / 8)] for k in range(1, 8)
        )

    def _watch(self):
        if any(self._sees(sentry) for sentry in self.sentries):
            self.alarm += 1
        elif self.steps % 2 == 0:
            self.alarm = max(0, self.alarm - 1)
        self.hurry = max(0, self.hurry - 1)
        if self.alarm >= ALARM_FULL:
            self.alarm = 0
            self.hurry = HURRY_STEPS
            self._new_imp("friend")
            return -0.3
        return 0.0

    def _new_imp(self, prey):
        along = float(self.np_random.uniform(RIM, SIZE - RIM))
        side = int(self.np_random.integers(4))
        x, y = [(along, 3.0), (along, SIZE - 4.0), (3.0, along), (SIZE - 4.0, along)][side]
        self.imps.append({"x": x, "y": y, "prey": prey, "fleeing": False})

    def _run_imps(self):
        reward = 0.0
        if self.steps % IMP_GAP == 0:
            self._new_imp("plant")
        if self.steps % IMP_GAP == IMP_GAP // 2:
            self._new_imp("friend")
        speed = IMP_SPEED * (1.6 if self.hurry else 1.0)
        for imp in self.imps:
            if math.hypot(imp["x"] - self.x, imp["y"] - self.y) < 6:
                imp["fleeing"] = True
            if imp["fleeing"]:
                dx, dy = imp["x"] - 42, imp["y"] - 42
            elif imp["prey"] == "friend":
                dx, dy = self.friend_x - imp["x"], self.friend_y - imp["y"]
            elif self.plants:
                plant = max(self.plants, key=lambda p: p[2])
                dx, dy = plant[0] - imp["x"], plant[1] - imp["y"]
                if math.hypot(dx, dy) < 2:
                    self.plants.remove(plant)
                    imp["fleeing"] = True
                    reward -= 0.2
            else:
                continue
            distance = math.hypot(dx, dy) or 1.0
            if imp["prey"] == "friend" and not imp["fleeing"] and distance < 3:
                imp["fleeing"] = True
                reward -= 0.2
                self.bites += 1
                if self.bites >= APPRENTICE_BITES:
                    self.bites = 0
                    self.lives -= 1
                    reward -= 1.0
            imp["x"] += speed * dx / distance
            imp["y"] += speed * dy / distance
        self.imps = [i for i in self.imps if 1 < i["x"] < SIZE - 2 and 1 < i["y"] < SIZE - 2]
        return reward

    # ---------------------------------------------------------------- picture

    def render(self):
        frame = self.floor.copy()
        for sentry in self.sentries:
            across, down = CONES[round(sentry["facing"] / (math.pi / 2))]
            xs = np.clip(across + int(sentry["x"]), 0, SIZE - 1)
            ys = np.clip(down + int(sentry["y"]), 0, SIZE - 1)
            lit = ~np.logical_or.accumulate(self.solid[ys, xs], axis=1)
            frame[ys[lit], xs[lit]] = PALE
        for x, y, _ in self.ashes:
            self._box(frame, x, y, 2, 2, ASH)
        for x, y, age in self.plants:
            self._box(frame, x, y, 1 if age < RIPE_AGE else 2, 1 if age < RIPE_AGE else 2, SPROUT)
            if age >= RIPE_AGE:
                self._box(frame, x, y, 1, 1, FLOWER if age < ROT_AGE - 15 else ROTTEN)
        for sentry in self.sentries:
            self._box(frame, sentry["x"], sentry["y"], 2, 2, (150, 30, 90))
        self._box(frame, self.friend_x, self.friend_y, 1, 2, APPRENTICE)
        for imp in self.imps:
            self._box(frame, imp["x"], imp["y"], 2, 1, EMBER if imp["prey"] == "plant" else (255, 70, 130))
            self._box(frame, imp["x"], imp["y"] - 2, 0, 0, FLOWER)
        self._box(frame, self.x, self.y, 3, 2, SMITH)
        self._box(frame, self.x, self.y, 2, 3, SMITH)
        self._box(frame, self.x, self.y, 1, 1, STEEL)
        for k in range(HARVEST_GOAL):
            frame[1:3, 3 + 4 * k : 6 + 4 * k] = FLOWER if k < self.harvested else (30, 14, 10)
        for k in range(self.lives):
            frame[1:3, SIZE - 6 - 5 * k : SIZE - 2 - 5 * k] = SMITH
        frame[SIZE - 3 : SIZE - 1, 2 : 2 + self.alarm] = EMBER
        frame[SIZE - 3 : SIZE - 1, SIZE - 2 - 2 * self.rim_hits : SIZE - 2] = STEEL
        return frame

    @staticmethod
    def _box(frame, x, y, half_w, half_h, colour):
        x, y = round(x), round(y)
        frame[max(0, y - half_h) : y + half_h + 1, max(0, x - half_w) : x + half_w + 1] = colour
