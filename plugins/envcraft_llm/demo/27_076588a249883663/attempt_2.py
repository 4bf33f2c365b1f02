"""Coral Reef: bridge the channels of a shallow reef with four planks and reach the island of the diving bell.

The diver swims where there is sand. Channels cut the sand into islands; the first button lays a plank across the channel
in front, or takes up the plank that lies there. A plank that was crossed four times breaks. Moving makes noise, and
noise calls sea urchins.
"""

import numpy as np
import gymnasium as gym
from gymnasium import spaces

W = H = 84
MAX_STEPS = 850
LIVES = 4
SPEED = 3
PLANKS = 4
PLANK_LENGTH = 12
PLANK_WEAR = 4
CHANNEL = 6
CALM = 2
LOUD = 40
HUNT = 50
URCHIN_SPEED = 1.4

TURQUOISE = (56, 178, 180)
RIPPLE = (86, 204, 200)
SAND = (226, 206, 160)
SAND_SHADE = (210, 188, 142)
CORAL = (240, 120, 130)
DEEP = (20, 60, 120)
WOOD = (140, 96, 58)
DIVER = (30, 36, 60)
MASK = (250, 220, 70)
URCHIN = (90, 30, 100)
BELL = (236, 196, 40)

DIRS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}
TOP = 6


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (H, W, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ reset
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.carried = PLANKS
        self.noise = 0
        self.won = False
        self.lost = False
        self.urchin = None  # [x, y, steps left]
        self.planks = []  # [x, y, horizontal, crossings]
        self._cut_islands()
        self._set_diver()
        self.visited = {self._island(self.x, self.y)}
        return self._observe(), self._info()

    def _cut_islands(self):
        """Four columns of islands, each column cut at heights of its own."""
        self.sand = np.zeros((H, W), bool)
        self.sand[TOP + 3 : H - 3, 3 : W - 3] = True
        self.island_ids = np.zeros((H, W), int)
        edges = [3, 22, 42, 62, W - 3]
        number = 0
        for left, right in zip(edges[:-1], edges[1:]):
            cut_a = int(self.np_random.integers(24, 34))
            cut_b = int(self.np_random.integers(50, 62))
            for top, bottom in ((TOP + 3, cut_a), (cut_a, cut_b), (cut_b, H - 3)):
                number += 1
                self.island_ids[top:bottom, left:right] = number
            for cut in (cut_a, cut_b):
                self.sand[cut - CHANNEL // 2 : cut + CHANNEL // 2, left:right] = False
        for edge in edges[1:-1]:
            self.sand[:, edge - CHANNEL // 2 : edge + CHANNEL // 2] = False
        ys, xs = np.nonzero(self.sand & (self.island_ids == 12))
        self.bell = (int(xs.mean()), int(ys.mean()))

    def _set_diver(self):
        ys, xs = np.nonzero(self.sand & (self.island_ids == 1))
        self.home = (int(xs.mean()), int(ys.mean()))
        self.x, self.y = self.home
        self.facing = 4

    def _island(self, x, y):
        return int(self.island_ids[y, x])

    # ------------------------------------------------------------------ step
    def step(self, action):
        move, lay = int(action[0]), int(action[1])
        if self.won or self.lost:
            return self._observe(), 0.0, True, False, self._info()
        self.steps += 1
        reward = -0.001
        if move:
            self.facing = move
            reward += self._swim(move)
            self.noise = min(LOUD, self.noise + 1)
        else:
            self.noise = max(0, self.noise - CALM)
        if lay:
            self._lay_or_take()
        reward += self._hunt()
        if self._island(self.x, self.y) == 12 and self.sand[self.y, self.x]:
            self.won = True
            reward += 5.0
        elif self.lives <= 0 or (self.carried == 0 and not self.planks):
            self.lost = True
            reward -= 1.0
        terminated = self.won or self.lost
        truncated = not terminated and self.steps >= MAX_STEPS
        return self._observe(), reward, terminated, truncated, self._info()

    def _swim(self, move):
        dx, dy = DIRS[move]
        before = self._plank_at(self.x, self.y)
        x = min(max(self.x + SPEED * dx, 4), W - 5)
        y = min(max(self.y + SPEED * dy, TOP + 4), H - 5)
        self.x, self.y = x, y
        plank = self._plank_at(x, y)
        reward = 0.0
        if before is not None and plank is not before:
            before[3] += 1
            if before[3] >= PLANK_WEAR:
                self.planks.remove(before)
        if not self.sand[y, x] and plank is None:
            self.lives -= 1
            self.x, self.y = self.home
            return -0.5
        if self.sand[y, x]:
            island = self._island(x, y)
            if island not in self.visited:
                self.visited.add(island)
                self.home = (x, y)
                reward += 0.3
        return reward

    def _plank_at(self, x, y):
        for plank in self.planks:
            half_w, half_h = (PLANK_LENGTH // 2, 3) if plank[2] else (3, PLANK_LENGTH // 2)
            if abs(plank[0] - x) <= half_w and abs(plank[1] - y) <= half_h:
                return plank
        return None

    def _lay_or_take(self):
        dx, dy = DIRS[self.facing]
        ahead = self._plank_at(self.x + 5 * dx, self.y + 5 * dy)
        if ahead is not None and self._plank_at(self.x, self.y) is None:
            self.planks.remove(ahead)
            self.carried += 1
        elif self.carried > 0 and self.sand[self.y, self.x]:
            px, py = self.x + 7 * dx, self.y + 7 * dy
            if 4 <= px < W - 4 and TOP + 4 <= py < H - 4 and not self.sand[self.y + 4 * dy, self.x + 4 * dx]:
                self.planks.append([px, py, dx != 0, 0])
                self.carried -= 1

    def _hunt(self):
        if self.urchin is None:
            if self.noise >= LOUD:
                self.noise = 0
                self.urchin = [0.0 if self.x < W / 2 else W - 1.0, float(self.y), HUNT]
            return 0.0
        dx, dy = self.x - self.urchin[0], self.y - self.urchin[1]
        distance = max(1.0, float(np.hypot(dx, dy)))
        self.urchin[0] += URCHIN_SPEED * dx / distance
        self.urchin[1] += URCHIN_SPEED * dy / distance
        self.urchin[2] -= 1
        if distance < 4:
            self.urchin = None
            self.lives -= 1
            return -0.5
        if self.urchin[2] <= 0:
            self.urchin = None
        return 0.0

    def _info(self):
        return {"is_success": self.won, "lives": self.lives, "carried": self.carried, "islands": len(self.visited)}

    # ------------------------------------------------------------------ picture
    def _observe(self):
        # Everything is painted anew at every step, after the state has changed.
        frame = self._reef()
        self._drift_ripples(frame)
        self._paint_things(frame)
        return frame

    def _drift_ripples(self, frame):
        """Thin lines of light that wander down the channels and over the sand."""
        phase = self.steps // 2
        rows = np.arange(TOP, H)
        for start in range(0, W, 14):
            columns = 3 + (start + phase + 2 * np.sin(rows / 5.0)).astype(int) % (W - 6)
            on_sand = self.sand[rows, columns]
            frame[rows, columns] = np.where(on_sand[:, None], SAND_SHADE, RIPPLE)

    def render(self):
        return self._observe()

    def _reef(self):
        """The ground: water, sand, the two walls of coral and the strip for the counts."""
        canvas = np.empty((H, W, 3), np.uint8)
        canvas[:] = TURQUOISE
        canvas[2::9, ::2] = RIPPLE
        canvas[self.sand] = SAND
        canvas[:, :3] = CORAL
        canvas[:, W - 3 :] = CORAL
        canvas[:TOP] = DEEP
        return canvas

    def _paint_things(self, canvas):
        """What moves or changes: planks, bell, urchin, diver and counts."""
        for x, y, horizontal, wear in self.planks:
            half_w, half_h = (PLANK_LENGTH // 2, 2) if horizontal else (2, PLANK_LENGTH // 2)
            self._blit(canvas, x, y, half_w, half_h, tuple(max(0, c - 20 * wear) for c in WOOD))
        self._blit(canvas, *self.bell, 4, 4, BELL)
        if self.urchin is not None:
            self._blit(canvas, int(self.urchin[0]), int(self.urchin[1]), 2, 2, URCHIN)
        self._blit(canvas, self.x, self.y, 2, 2, DIVER)
        self._blit(canvas, self.x, self.y - 1, 1, 0, MASK)
        for k in range(self.lives):
            self._blit(canvas, 5 + 5 * k, 2, 1, 1, CORAL)
        for k in range(self.carried):
            self._blit(canvas, 32 + 5 * k, 2, 1, 1, WOOD)
        self._blit(canvas, 58 + self.noise // 4, 2, self.noise // 4, 1, URCHIN)

    @staticmethod
    def _blit(canvas, x, y, half_w, half_h, colour):
        """Fill the box round (x, y), as far as it lies on the canvas."""
        rows = np.arange(max(0, y - half_h), min(H, y + half_h + 1))
        columns = np.arange(max(0, x - half_w), min(W, x + half_w + 1))
        patch = canvas[np.ix_(rows, columns)]
        patch[:] = colour
