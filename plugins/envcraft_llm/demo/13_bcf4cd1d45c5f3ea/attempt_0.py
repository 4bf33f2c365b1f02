"""
Circuit Board Climb
===================
The electron climbs a wall of solder holds, 36 holds high. Every hold costs strength, ledges give it back, short
circuits push, check marks have to be passed in time and gliding platforms cross the gaps.
"""
import math
import gym
from gym import spaces
import numpy as np
import pygame

WIDTH = 84
HEIGHT = 84
HOLD_SPACING = 10
TOTAL_HOLDS = 36
MAX_STRENGTH = 30
REST_STEPS = 2
LOOSE_STEPS = 20
HANG_LIMIT = 30
CHECK_LIMIT = 140
CHECK_HEIGHTS = [9, 18, 27]
LIVES = 4
MAX_STEPS = 850
NUM_LIFTS = 4
COLUMNS = 7

BOARD_GREEN = (16, 84, 50)
DARK_GREEN = (10, 60, 36)
COPPER = (200, 120, 60)
SILVER = (200, 204, 210)
SPARK_YELLOW = (255, 240, 80)
RED = (230, 60, 40)
BLACK = (10, 14, 12)
BLUE = (60, 120, 220)


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode="rgb_array"):
        super(GameEnv, self).__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(low=0, high=255, shape=(HEIGHT, WIDTH, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete(5, 2, 2)
        self.frame = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.score = 0
        self.lives = LIVES
        self.strength = MAX_STRENGTH
        self.rest_timer = 0
        self.hang_timer = 0
        self.row = 0
        self.col = COLUMNS // 2
        self.last_ledge = (0, COLUMNS // 2)
        self.check_timer = 0
        self.next_check = 0
        self.loose_timer = {}
        self.shorts = []
        self.is_success = False
        self._build_wall()
        self._build_lifts()
        return self._get_obs(), self._get_info()

    def _build_wall(self):
        """Create holds (1), loose holds (2) and ledges (3) for every row of the wall."""
        self.wall = np.zeros((TOTAL_HOLDS + 1, COLUMNS), dtype=np.int32)
        path = COLUMNS // 2
        for row in range(TOTAL_HOLDS + 1):
            self.wall[row] = (self.np_random.random(COLUMNS) < 0.55).astype(np.int32)
            path = int(np.clip(path + self.np_random.integers(-1, 2), 0, COLUMNS - 1))
            self.wall[row, path] = 1
            for col in range(COLUMNS):
                if self.wall[row, col] == 1 and self.np_random.random() < 0.15 and col != path:
                    self.wall[row, col] = 2
            if row % 6 == 0:
                self.wall[row, max(0, path - 1):path + 2] = 3
        self.wall[0, :] = 3

    def _build_lifts(self):
        """Narrow platforms that glide back and forth."""
        self.lifts = []
        for i in range(NUM_LIFTS):
            row = 4 + i * 8
            x = float(self.np_random.integers(0, COLUMNS))
            direction = 1 if self.np_random.random() < 0.5 else -1
            self.lifts.append({"row": row, "x": x, "dir": direction})

    def _move_lifts(self):
        for lift in self.lifts:
            lift["x"] += 0.1 * lift["dir"]
            if lift["x"] <= 0 or lift["x"] >= COLUMNS - 1:
                lift["dir"] = -lift["dir"]
                lift["x"] = min(max(lift["x"], 0.0), float(COLUMNS - 1))

    def _on_lift(self):
        for lift in self.lifts:
            if lift["row"] == self.row and abs(lift["x"] - self.col) < 1.0:
                return True
        return False

    def _hold_at(self, row, col):
        if row < 0 or row > TOTAL_HOLDS or col < 0 or col >= COLUMNS:
            return 0
        return self.wall[row, col]

    def _fall(self):
        """Lose a life and go back to the last ledge."""
        self.lives -= 1
        self.row, self.col = self.last_ledge
        self.strength = MAX_STRENGTH
        self.hang_timer = 0
        return -1.0

    def _climb(self, move, leap):
        delta = {1: (1, 0), 2: (-1, 0), 3: (0, -1), 4: (0, 1)}[move]
        distance = 2 if leap else 1
        cost = 3 if leap else 1
        if self.strength < cost
            return 0.0
        row = self.row + delta[0] * distance
        col = self.col + delta[1] * distance
        if row > TOTAL_HOLDS - 1:
            self.is_success = True
            return 5.0
        if self._hold_at(row, col) == 0:
            return 0.0
        reward = 0.1 * max(0, row - self.row)
        self.row, self.col = row, col
        self.strength -= cost
        if self._hold_at(row, col) == 2:
            self.loose_timer[(row, col)] = LOOSE_STEPS
        if self._hold_at(row, col) == 3:
            self.last_ledge = (row, col)
        return reward

    def _update_loose(self):
        reward = 0.0
        for key in list(self.loose_timer.keys()):
            self.loose_timer[key] -= 1
            if self.loose_timer[key] <= 0:
                del self.loose_timer[key]
                self.wall[key[0], key[1]] = 0
                if (self.row, self.col) == key:
                    reward += self._fall()
        return reward

    def _update_shorts(self):
        """Short circuits come out of the windows and push sideways."""
        if self.steps % 25 == 0:
            side = 1 if self.np_random.random() < 0.5 else -1
            start = 0.0 if side > 0 else float(COLUMNS - 1)
            self.shorts.append([self.row + int(self.np_random.integers(0, 4)), start, side])
        reward = 0.0
        for short in self.shorts:
            short[1] += 0.25 * short[2]
            if short[0] == self.row and abs(short[1] - self.col) < 0.4:
                target = int(self.col + short[2])
                if self._hold_at(self.row, target) > 0:
                    self.col = target
                elif not self._on_lift():
                    reward += self._fall()
        self.shorts = [short for short in self.shorts if -1 < short[1] < COLUMNS]
        return reward

    def _update_checks(self):
        if self.next_check >= len(CHECK_HEIGHTS):
            return 0.0
        self.check_timer += 1
        if self.row >= CHECK_HEIGHTS[self.next_check]:
            self.next_check += 1
            self.check_timer = 0
            return 1.0
        if self.check_timer > CHECK_LIMIT:
            self.check_timer = 0
            self.lives -= 1
            return -1.0
        return 0.0

    def step(self, action):
        move, rest, leap = int(action[0]), int(action[1]), int(action[2])
        self.steps += 1
        reward = 0.0
        if move > 0 and not rest:
            reward += self._climb(move, leap)
        on_ledge = self._hold_at(self.row, self.col) == 3
        if on_ledge or rest:
            self.rest_timer += 1
            if self.rest_timer >= REST_STEPS:
                self.rest_timer = 0
                self.strength = min(MAX_STRENGTH, self.strength + 1)
        self.hang_timer = self.hang_timer + 1 if self.strength <= 0 else 0
        reward += self._update_loose()
        reward += self._update_shorts()
        reward += self._update_checks()
        self._move_lifts()
        done = self.is_success or self.lives <= 0 or self.hang_timer >= HANG_LIMIT or self.steps >= MAX_STEPS
        self.score += reward
        return self._get_obs(), reward, done, self._get_info()

    def _get_info(self):
        return {"is_success": self.is_success, "lives": self.lives, "row": self.row, "strength": self.strength}

    def _fill(self, x, y, w, h, color):
        x0, y0 = max(0, int(x)), max(0, int(y))
        x1, y1 = min(WIDTH, int(x + w)), min(HEIGHT, int(y + h))
        if x1 > x0 and y1 > y0:
            self.frame[y0:y1, x0:x1] = color

    def _get_obs(self):
        self.frame[:] = BOARD_GREEN
        for i in range(0, WIDTH, 14):
            self._fill(i + 3, 0, 1, HEIGHT, DARK_GREEN)
        camera = self.row * HOLD_SPACING - 40
        for row in range(TOTAL_HOLDS + 1):
            y = HEIGHT - 10 - (row * HOLD_SPACING - camera)
            if y < -10 or y > HEIGHT:
                continue
            for col in range(COLUMNS):
                x = col * 12 + 4
                kind = self.wall[row, col]
                if kind == 1:
                    self._fill(x + 2, y + 2, 4, 4, SILVER)
                elif kind == 2:
                    self._fill(x + 2, y + 2, 4, 4, COPPER)
                elif kind == 3:
                    self._fill(x - 2, y + 6, 12, 2, COPPER)
            if row in CHECK_HEIGHTS:
                done = CHECK_HEIGHTS.index(row) < self.next_check
                self._fill(0, y, 3, 6, SPARK_YELLOW if done else BLUE)
        for lift in self.lifts:
            y = HEIGHT - 10 - (lift["row"] * HOLD_SPACING - camera)
            self._fill(lift["x"] * 12 + 2, y + 8, 12, 2, SILVER)
        for short in self.shorts:
            y = HEIGHT - 10 - (short[0] * HOLD_SPACING - camera)
            wobble = int(2 * math.sin(self.steps * 0.5))
            self._fill(short[1] * 12 + 5, y + 2 + wobble, 5, 3, RED)
        y = HEIGHT - 10 - (self.row * HOLD_SPACING - camera)
        self._fill(self.col * 12 + 4, y, 7, 7, SPARK_YELLOW)
        self._fill(self.col * 12 + 6, y + 2, 3, 3, BLACK)
        self._fill(0, 0, WIDTH, 4, BLACK)
        self._fill(1, 1, 50 * self.strength / MAX_STRENGTH, 2, RED)
        for i in range(self.lives):
            self._fill(58 + i * 6, 1, 4, 2, SPARK_YELLOW)
        return self.frame.copy()

    def render(self):
        return self._get_obs()
