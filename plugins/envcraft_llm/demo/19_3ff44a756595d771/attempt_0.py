"""Container Harbour: a forklift cuts pieces out of a quay of coloured patches, away from runaway trucks.

Claimed ground is safe but for the sparks that run along its border. A line is drawn into the open while the first
button is held; where it closes, the side without trucks is claimed and scores its most frequent colour. Three claims
in a row with the same colour burst whatever was claimed in the others. The second button hooks parcels from ripples.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

CELL = 3
COLS, ROWS = 28, 24
TOP = 12
OPEN, CLAIMED, LINE = 0, 1, 2
COLOURS = 4
GOAL = 75
MOST_BURST = 100
TRUCKS, SPARKS = 3, 3
DRAW_PACE, TRUCK_PACE, SPARK_PACE = 2, 3, 3
CALM = 40
RIPPLE_EVERY, RIPPLE_SHOWN, RIPPLE_NEAR = 40, 5, 10
PARCEL_REWARD = 1.5
LIVES, GRACE = 3, 20
MAX_STEPS = 1000

SEA, CONCRETE = (92, 104, 116), (58, 64, 72)
RED, BLUE, YELLOW, GREY = (196, 52, 44), (40, 92, 170), (226, 180, 40), (150, 156, 160)
INK = np.array([RED, BLUE, YELLOW, GREY], np.uint8)
WASHED = (INK // 2 + 20).astype(np.uint8)  # open patches are dull, claimed ones bright
WIRE, FORK, FORK_DARK = (255, 255, 255), (255, 140, 20), (40, 30, 20)
TRUCK, TRUCK_LAMP = (20, 20, 26), (255, 60, 60)
SPARK, FOAM, PARCEL = (255, 250, 140), (200, 230, 250), (176, 124, 70)
HUD = (30, 34, 40)

WAYS = {1: (-1, 0), 2: (1, 0), 3: (0, -1), 4: (0, 1)}  # row, column


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(low=0, high=255, shape=(84, 84, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        rng = self.np_random
        self.steps = 0
        blocks = rng.integers(0, COLOURS, size=(ROWS // 2, COLS // 2))
        self.colour = blocks.repeat(2, axis=0).repeat(2, axis=1).astype(np.int8)
        self.ground = np.full((ROWS, COLS), OPEN, np.int8)
        self.ground[[0, -1]] = self.ground[:, [0, -1]] = CLAIMED
        self.scored = np.full((ROWS, COLS), -1, np.int8)  # the colour that a claimed patch counts for
        self.fork = (ROWS - 1, COLS // 2)
        self.line = []
        self.line_start = self.fork
        self.trucks = []
        for _ in range(TRUCKS):
            row, col = int(rng.integers(6, ROWS - 8)), int(rng.integers(6, COLS - 6))
            self.trucks.append([row, col, 1 if rng.integers(2) else -1, 1 if rng.integers(2) else -1])
        self.sparks = [[0, int(rng.integers(2, COLS - 2)), 0, 1 if k % 2 else -1] for k in range(SPARKS)]
        self.lives, self.grace = LIVES, GRACE
        self.calm = 0
        self.burst = 0
        self.last_colours = []
        self.ripple = None
        self.ripple_left = 0
        self.parcels = 0
        self.won = False
        return self.render(), self._info()

    # -- rules ------------------------------------------------------------------------------------------------

    def counts(self):
        return [int((self.scored == colour).sum()) for colour in range(COLOURS)]

    def step(self, action):
        move, draw, hook = (int(part) for part in action)
        self.steps += 1
        reward = 0.0
        if not self._over():
            self.grace, self.calm = max(0, self.grace - 1), max(0, self.calm - 1)
            reward += self._drive(move, draw)
            reward += self._drive_trucks() + self._run_sparks() + self._ripple(hook)
            if max(self.counts()) >= GOAL:
                self.won = True
                reward += 5.0
        terminated = self._over()
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), float(reward), terminated, truncated, self._info()

    def _over(self):
        return self.won or self.lives <= 0 or self.burst >= MOST_BURST

    def _drive(self, move, draw):
        if move == 0:
            return 0.0
        row, col = self.fork[0] + WAYS[move][0], self.fork[1] + WAYS[move][1]
        if not (0 <= row < ROWS and 0 <= col < COLS):
            return 0.0
        target = self.ground[row, col]
        if target == CLAIMED:
            if self.line and self.steps % DRAW_PACE:
                return 0.0
            self.fork = (row, col)
            return self._close_line() if self.line else 0.0
        if target == LINE or not draw or self.steps % DRAW_PACE:
            return 0.0
        if not self.line:
            self.line_start = self.fork
        self.fork = (row, col)
        self.line.append(self.fork)
        self.ground[row, col] = LINE
        return 0.0

    def reachable(self, starts, wall):
        """Open cells that can be got to from the starts without crossing `wall`."""
        seen = np.zeros((ROWS, COLS), bool)
        for row, col in starts:
            seen[row, col] = True
        seen &= ~wall
        while True:
            grown = seen.copy()
            grown[1:] |= seen[:-1]
            grown[:-1] |= seen[1:]
            grown[:, 1:] |= seen[:, :-1]
            grown[:, :-1] |= seen[:, 1:]
            grown &= ~wall
            if (grown == seen).all():
                return seen
            seen = grown

    def _close_line(self):
        for row, col in self.line:
            self.ground[row, col] = CLAIMED
        wild = self.reachable([(truck[0], truck[1]) for truck in self.trucks], self.ground == CLAIMED)
        area = (self.ground == OPEN) & ~wild
        for row, col in self.line:
            area[row, col] = True
        self.line = []
        self.ground[area] = CLAIMED
        tally = np.bincount(self.colour[area], minlength=COLOURS)
        colour = int(tally.argmax())
        self.scored[area & (self.colour == colour)] = colour
        reward = 0.02 * int(tally[colour])
        self.last_colours = [*self.last_colours, colour][-3:]
        if self.last_colours == [colour] * 3:
            reward -= self._burst_others(colour)
        return reward

    def _burst_others(self, colour):
        """Patches that count for other colours fall back into the open; the ring stays."""
        lost = (self.scored >= 0) & (self.scored != colour)
        lost[self.fork] = False
        self.ground[lost] = OPEN
        self.scored[lost] = -1
        self.burst += int(lost.sum())
        self.last_colours = []
        self.calm = CALM
        return 0.01 * int(lost.sum())

    def _hurt(self):
        for row, col in self.line:
            self.ground[row, col] = OPEN
        if self.line:
            self.fork = self.line_start
        self.line = []
        if self.grace:
            return 0.0
        self.lives -= 1
        self.grace = GRACE
        return -1.0

    def _drive_trucks(self):
        if self.steps % TRUCK_PACE or self.calm:
            return 0.0
        reward = 0.0
        for truck in self.trucks:
            row, col, down, right = truck
            if self.ground[row + down, col] == CLAIMED:
                down = -down
            if self.ground[row, col + right] == CLAIMED:
                right = -right
            if self.ground[row + down, col + right] == CLAIMED:
                down, right = -down, -right
            truck[2:] = down, right
            if self.ground[row + down, col + right] != CLAIMED:
                truck[0], truck[1] = row + down, col + right
            if self.ground[truck[0], truck[1]] == LINE:
                reward += self._hurt()
        return reward

    def _on_border(self, row, col):
        around = self.ground[max(0, row - 1) : row + 2, max(0, col - 1) : col + 2]
        return self.ground[row, col] == CLAIMED and bool((around != CLAIMED).any())

    def _run_sparks(self):
        reward = 0.0
        for spark in self.sparks:
            row, col, down, right = spark
            if self.steps % SPARK_PACE == 0:
                ways = [(down, right), (right, down), (-right, -down), (-down, -right)]
                for way in ways:
                    target = (row + way[0], col + way[1])
                    if 0 <= target[0] < ROWS and 0 <= target[1] < COLS and self._on_border(*target):
                        spark[:] = [*target, *way]
                        break
                else:  # cut off: hurry along the edge of the board until there is a border again
                    spark[0], spark[1] = 0, (col + 1) % COLS
            if (spark[0], spark[1]) == self.fork and not self.line:
                reward += self._hurt()
        return reward

    def _ripple(self, hook):
        if self.steps % RIPPLE_EVERY == 0:
            self.ripple = (int(self.np_random.integers(ROWS)), int(self.np_random.integers(COLS)))
            self.ripple_left = RIPPLE_SHOWN
        if self.ripple is None:
            return 0.0
        near = max(abs(self.ripple[0] - self.fork[0]), abs(self.ripple[1] - self.fork[1])) * CELL <= RIPPLE_NEAR
        if hook and near:
            self.ripple = None
            self.parcels += 1
            return PARCEL_REWARD
        self.ripple_left -= 1
        if self.ripple_left < 0:
            self.ripple = None
        return 0.0

    def _info(self):
        return {"is_success": self.won, "best_colour": max(self.counts()), "lives": self.lives, "burst": self.burst}

    # -- picture ----------------------------------------------------------------------------------------------

    def _spot(self, img, row, col, ink, margin=0):
        y, x = TOP + row * CELL, col * CELL
        img[max(TOP, y - margin) : y + CELL + margin, max(0, x - margin) : x + CELL + margin] = ink

    def render(self):
        board = np.where((self.scored >= 0)[..., None], INK[self.colour], WASHED[self.colour])
        board[(self.ground == CLAIMED) & (self.scored < 0)] = CONCRETE
        board[self.ground == LINE] = WIRE
        img = np.empty((84, 84, 3), np.uint8)
        img[:TOP] = HUD
        img[TOP:] = board.repeat(CELL, axis=0).repeat(CELL, axis=1)
        if self.ripple is not None:
            row, col = self.ripple
            self._spot(img, row, col, FOAM, 2)
            self._spot(img, row, col, SEA, 1)
            self._spot(img, row, col, PARCEL)
        for row, col, _, _ in self.trucks:
            self._spot(img, row, col, TRUCK, 1)
            self._spot(img, row, col, TRUCK_LAMP if not self.calm else SEA)
        for row, col, _, _ in self.sparks:
            self._spot(img, row, col, SPARK)
        self._spot(img, *self.fork, FORK_DARK, 1)
        self._spot(img, *self.fork, WIRE if self.grace and self.steps % 4 < 2 else FORK)
        for colour, count in enumerate(self.counts()):
            img[1 + 2 * colour, 20:82] = CONCRETE
            img[1 + 2 * colour, 20 : 20 + min(62, 62 * count // GOAL)] = INK[colour]
        for life in range(max(0, self.lives)):
            img[2:6, 2 + 6 * life : 6 + 6 * life] = FORK
        img[9:11, 20 : 20 + 62 * min(self.burst, MOST_BURST) // MOST_BURST] = TRUCK_LAMP
        for parcel in range(min(self.parcels, 8)):
            img[8:10, 1 + 2 * parcel] = PARCEL
        return img
