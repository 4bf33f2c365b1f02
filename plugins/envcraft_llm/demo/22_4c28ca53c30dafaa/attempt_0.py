"""Radio Station: a sound engineer and a mirrored twin have to stand on the two cells of the antenna at the same time.

The pad moves both at once. Up and down are the same for both, left and right are reversed for the twin. Loudspeakers
stop either body alone, which is the only way to change the distance between the two; pits swallow. When most of the
way is done a burst of static begins to circle the antenna, and its touch costs a life.
"""

import math
from collections import deque

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 6
COLS, ROWS = 14, 12
TOP = 12
SPEAKERS, PITS = 16, 3
GUARD_SHARE = 0.4  # what is left of the task when the last guard appears
GUARD_REACH = 18
GUARD_TURN = 0.12
GUARD_TOUCH = 4
LIVES, GRACE = 4, 20
SHORTEST, LONGEST = 8, 60
MAX_STEPS = 1000

WALNUT, WALNUT_DARK = (92, 58, 38), (74, 46, 30)
DIAL, DIAL_LIT = (40, 110, 70), (110, 230, 140)
TAPE, REEL = (60, 40, 34), (180, 150, 120)
SPEAKER, CONE = (34, 32, 36), (120, 116, 124)
PIT = (10, 6, 8)
MAST, MAST_LIT = (214, 200, 160), (255, 250, 210)
ENGINEER, TWIN = (250, 160, 60), (90, 190, 240)
STATIC, STATIC_HOT = (230, 50, 50), (255, 220, 220)
WAVE = (110, 74, 50)

WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (84, 84, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        while not self._furnish():
            pass
        self.steps = 0
        self.lives, self.grace = LIVES, GRACE
        self.engineer, self.twin = self.starts
        self.nearest = self.whole_way = self._way_left()
        self.guard_angle = None
        self.fallen = self.won = False
        self.held = 0
        self.studio = self._draw_studio()
        return self._draw(), self._info()

    def _furnish(self):
        """Set out a studio in which the antenna can be reached in a fair number of moves."""
        self.speaker = np.zeros((COLS, ROWS), bool)
        self.pit = np.zeros((COLS, ROWS), bool)
        column, row = int(self.np_random.integers(4, COLS - 5)), int(self.np_random.integers(3, ROWS - 3))
        self.antenna = ((column, row), (column + 1, row))
        cells = [(c, r) for c in range(COLS) for r in range(ROWS) if (c, r) not in self.antenna]
        order = [cells[i] for i in self.np_random.permutation(len(cells)).tolist()]
        for c, r in order[:SPEAKERS]:
            self.speaker[c, r] = True
        for c, r in order[SPEAKERS : SPEAKERS + PITS]:
            self.pit[c, r] = True
        self.starts = tuple(order[SPEAKERS + PITS : SPEAKERS + PITS + 2])
        return self._solvable()

    def _solvable(self):
        goal = set(self.antenna)
        distance = {self.starts: 0}
        queue = deque([self.starts])
        while queue:
            pair = queue.popleft()
            if set(pair) == goal:
                return distance[pair] >= SHORTEST
            if distance[pair] >= LONGEST or len(distance) > 4000:
                return False
            for dc, dr in WAYS.values():
                after = (self._inside(pair[0], dc, dr), self._inside(pair[1], -dc, dr))
                if after not in distance and not any(self.pit[cell] for cell in after):
                    distance[after] = distance[pair] + 1
                    queue.append(after)
        return False

    def _inside(self, cell, dc, dr):
        column, row = cell[0] + dc, cell[1] + dr
        if not (0 <= column < COLS and 0 <= row < ROWS) or self.speaker[column, row]:
            return cell
        return column, row

    # -- rules ------------------------------------------------------------------------------------------------------

    def _way_left(self):
        """Cells that both bodies together are away from the antenna, by the better assignment."""
        first, second = self.antenna

        def away(cell, goal):
            return abs(cell[0] - goal[0]) + abs(cell[1] - goal[1])

        straight = away(self.engineer, first) + away(self.twin, second)
        crossed = away(self.engineer, second) + away(self.twin, first)
        return min(straight, crossed)

    def _move_body(self, cell, dc, dr):
        """One cell, unless a loudspeaker is in the way."""
        column, row = cell[0] + dc, cell[1] + dr
        if column < 0 or row < 0 or self.speaker[column, row]:
            return cell
        return column, row

    def step(self, action):
        move = int(action[0])
        self.steps += 1
        reward = 0.0
        if not (self.won or self.fallen or self.lives <= 0):
            self.grace = max(0, self.grace - 1)
            # One cell a move: a held direction repeats every third step.
            self.held = self.held + 1 if move else 0
            if move and self.held % 3 == 1:
                dc, dr = WAYS[move]
                self.engineer = self._move_body(self.engineer, dc, dr)
                self.twin = self._move_body(self.twin, -dc, dr)
                reward += self._judge_move()
            reward += self._circle()
        terminated = bool(self.won or self.fallen or self.lives <= 0)
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._draw(), float(reward), terminated, truncated, self._info()

    def _judge_move(self):
        if self.pit[self.engineer] or self.pit[self.twin]:
            self.fallen = True
            return -2.0
        if {self.engineer, self.twin} == set(self.antenna):
            self.won = True
            return 5.0
        left = self._way_left()
        gained = max(0, self.nearest - left)
        self.nearest = min(self.nearest, left)
        if self.guard_angle is None and left <= GUARD_SHARE * self.whole_way:
            self.guard_angle = float(self.np_random.uniform(0, 2 * math.pi))
        return 0.1 * gained

    def guard_spot(self):
        (c, r), _ = self.antenna
        x, y = (c + 1) * CELL, TOP + r * CELL + CELL // 2
        return x + GUARD_REACH * math.cos(self.guard_angle), y + GUARD_REACH * math.sin(self.guard_angle)

    def _circle(self):
        if self.guard_angle is None:
            return 0.0
        self.guard_angle += GUARD_TURN
        x, y = self.guard_spot()
        for c, r in (self.engineer, self.twin):
            touched = math.hypot(c * CELL + 3 - x, TOP + r * CELL + 3 - y) < GUARD_TOUCH
            if touched and not self.grace:
                self.lives -= 1
                self.grace = GRACE
                return -1.0
        return 0.0

    def _info(self):
        return {"is_success": self.won, "way_left": self._way_left(), "lives": self.lives, "fallen": self.fallen}

    # -- picture ----------------------------------------------------------------------------------------------------

    def _cell(self, img, cell, ink, margin=0):
        x, y = cell[0] * CELL, TOP + cell[1] * CELL
        img[y + margin : y + CELL - margin, x + margin : x + CELL - margin] = ink

    def _draw_studio(self):
        img = np.empty((84, 84, 3), np.uint8)
        img[:] = WALNUT
        img[TOP::CELL] = img[:, ::CELL] = WALNUT_DARK
        (ac, ar), _ = self.antenna
        rows, cols = np.indices((84, 84))
        rings = np.hypot(rows - TOP - ar * CELL - 3, cols - ac * CELL - CELL)
        img[(rings.astype(int) % 12 == 0) & (rows >= TOP)] = WAVE  # sound rolling across the floor
        img[:TOP] = DIAL
        img[:TOP, 30:54] = TAPE
        for x in (36, 48):
            img[2:10, x - 4 : x + 4] = REEL
            img[5:7, x - 1 : x + 1] = TAPE
        for c, r in np.argwhere(self.speaker).tolist():
            self._cell(img, (c, r), SPEAKER)
            self._cell(img, (c, r), CONE, 2)
        for c, r in np.argwhere(self.pit).tolist():
            self._cell(img, (c, r), PIT)
        for cell in self.antenna:
            self._cell(img, cell, MAST)
            self._cell(img, cell, MAST_LIT, 2)
        return img

    def _draw(self):
        img = self.studio.copy()
        self._cell(img, self.engineer, ENGINEER, 1)
        self._cell(img, self.twin, TWIN, 1)
        for cell in (self.engineer, self.twin):
            x, y = cell[0] * CELL, TOP + cell[1] * CELL
            img[y + 2, [x + 2, x + 4]] = TAPE
        if self.guard_angle is not None:
            x, y = (int(v) for v in self.guard_spot())
            x, y = min(max(x, 2), 81), min(max(y, 2), 81)
            img[y - 2 : y + 3, x - 2 : x + 3] = STATIC
            img[y, x - 2 : x + 3 : 2] = img[y - 2 : y + 3 : 2, x] = STATIC_HOT
        for life in range(max(0, self.lives)):
            img[3:9, 3 + 6 * life : 7 + 6 * life] = ENGINEER
        done = 1 - self.nearest / max(1, self.whole_way)
        img[4:8, 57:82] = TAPE
        img[4:8, 57 : 57 + int(25 * done)] = DIAL_LIT
        return img

    def render(self):
        return self._draw()
