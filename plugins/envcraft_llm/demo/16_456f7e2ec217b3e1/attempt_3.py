"""Haunted Theatre: a stagehand runs across an endless empty stage with something close behind.

Prop trunks and gaps are jumped, hanging beams are slid under. Shapes of five golden trunks drop from the flies and stay
where they land, as steps on the stage; eight side by side vanish with a reward. The boards under each jump are claimed
in the stagehand's colour, and phantoms that drift onto claimed boards vanish for a while.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
GROUND = 70
HOME_X = 34  # where the stagehand runs on the screen
GIVE = 16
BODY_W, TALL, LOW = 6, 10, 5
JUMP, GRAVITY = 3.0, 0.3

GOAL = 900
SLOW, FAST = 1.5, 3.5
MAX_STEPS = 850
LIVES = 3
CHASE, CHASE_GAIN = 20, 8
GRACE = 25

TRUNK, BEAM, GAP = 0, 1, 2
TRUNK_W, TRUNK_H = 6, 7
BEAM_W, BEAM_CLEAR = 8, 6
GAP_W = 13
FIRST_OBSTACLE = 110

CELL = 4
SHAPE_EVERY = 50
SHAPE_FALL = 1.5
ROW_FULL = 8
ROW_REWARD = 1.0
# Columns and heights of shapes of five cells, seen as how many cells lie on each column.
SHAPES = [(1, 1, 1, 1, 1), (2, 1, 1, 1), (1, 2, 1, 1), (1, 1, 1, 2), (2, 2, 1), (1, 2, 2)]

TENTH = SIZE / 10
CLAIM_REWARD = 0.5
PHANTOM_BACK = 60
PHANTOM_SPEED = 0.4

VELVET, VELVET_FOLD = (110, 16, 34), (78, 8, 24)
BACKSTAGE = (30, 18, 28)
BOARD, BOARD_SEAM, CLAIMED = (120, 90, 60), (96, 70, 46), (64, 120, 130)
PIT = (8, 4, 8)
WOOD, WOOD_EDGE = (150, 104, 62), (92, 60, 36)
BEAM_INK, CHAIN = (82, 84, 96), (160, 160, 170)
GOLDEN, GOLDEN_EDGE = (232, 184, 60), (160, 120, 30)
SHIRT, FACE, CAP = (60, 130, 220), (240, 206, 170), (30, 40, 70)
GHOST, GHOST_EYES = (236, 240, 250), (60, 50, 80)
FOOTLIGHT = (255, 220, 120)


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.curtain = self._sew_curtain()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.run = 0.0  # pixels run so far
        self.offset = 0.0
        self.y, self.vy = float(GROUND), 0.0
        self.grounded, self.sliding = True, False
        self.lives, self.grace = LIVES, 0
        self.chase = CHASE
        self.obstacles = []  # [kind, left edge on the stage]
        self.next_pattern = FIRST_OBSTACLE
        self.falling = None  # [left column on the stage, y of its bottom, heights]
        self.heaps = {}  # stage column: golden trunks on it
        self.claimed = set()  # stage pixels
        self.best_tenth = 0
        self.takeoff = None
        self.phantoms = [[130.0, 0]]  # [x on the stage, steps until it comes back]
        self.won = False
        return self._picture(), self._info()

    # -- step ---------------------------------------------------------------------------------------------------------

    @property
    def speed(self):
        return min(FAST, SLOW + (FAST - SLOW) * self.run / GOAL)

    @property
    def stage_x(self):
        """The left edge of the stagehand on the stage."""
        return self.run + HOME_X + self.offset

    def step(self, action):
        move, jump, _ = (int(part) for part in action)
        self.steps += 1
        reward = 0.0
        if not self.won and self.lives > 0:
            self.grace = max(0, self.grace - 1)
            self.run += self.speed
            if move in (3, 4):
                self.offset = float(np.clip(self.offset + (1.0 if move == 4 else -1.0), -GIVE, GIVE))
            self._lay_patterns()
            reward += self._leap(move == 1 or jump == 1, move == 2)
            reward += self._meet_obstacles() + self._drop_shapes() + self._meet_phantoms()
            self._forget_the_past()
            if self.run >= GOAL and self.lives > 0:
                self.won = True
                reward += 5.0
        terminated = self.won or self.lives <= 0
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._picture(), float(reward), terminated, truncated, self._info()

    def _lay_patterns(self):
        """Patterns of two obstacles, far enough apart to land between them."""
        while self.next_pattern < self.run + 2 * SIZE:
            for kind in self.np_random.integers(0, 3, size=2).tolist():
                self.obstacles.append([kind, self.next_pattern])
                self.next_pattern += 40 + int(14 * self.speed) + int(self.np_random.integers(0, 12))
            self.next_pattern += 10

    def height_at(self, x):
        """How high the golden heaps stand at a stage pixel."""
        return CELL * self.heaps.get(int(x) // CELL, 0)

    def over_gap(self, x):
        return any(kind == GAP and left <= x < left + GAP_W for kind, left in self.obstacles)

    def _leap(self, jump, slide):
        middle = self.stage_x + BODY_W / 2
        floor = GROUND - self.height_at(middle)
        self.sliding = slide and self.grounded
        if self.grounded:
            if jump:
                self.vy, self.grounded = -JUMP, False
                self.takeoff = middle
            elif floor < self.y - CELL:
                self.heaps.pop(int(middle) // CELL, None)  # runs into a heap and scatters it
                return self._stumble()
            else:
                self.y = float(floor)
            return 0.0
        self.y += self.vy
        self.vy += GRAVITY
        if self.vy > 0 and self.y >= floor:
            self.y, self.vy, self.grounded = float(floor), 0.0, True
            return self._claim(int(self.takeoff), int(middle))
        return 0.0

    def _claim(self, start, end):
        """A jump closes a loop with the boards below it."""
        self.claimed.update(x for x in range(start, end) if not self.over_gap(x))
        seen = sum(self.run <= x < self.run + SIZE for x in self.claimed)
        tenth = int(seen / TENTH)
        gained = max(0, tenth - self.best_tenth)
        self.best_tenth += gained
        return CLAIM_REWARD * gained

    def _stumble(self):
        if self.grace:
            return 0.0
        self.lives -= 1
        self.chase -= CHASE_GAIN
        self.offset = max(-float(GIVE), self.offset - 6)
        self.grace = GRACE
        if self.chase <= 0:
            self.lives = 0
        return -1.0

    def _meet_obstacles(self):
        left, right = self.stage_x, self.stage_x + BODY_W
        head = self.y - (LOW if self.sliding else TALL)
        for kind, edge in self.obstacles:
            if kind == TRUNK and right > edge + 1 and left < edge + TRUNK_W - 1 and self.y > GROUND - TRUNK_H + 1:
                return self._stumble()
            if kind == BEAM and right > edge and left < edge + BEAM_W and head < GROUND - BEAM_CLEAR:
                return self._stumble()
            if kind == GAP and self.y >= GROUND and edge < left + BODY_W / 2 < edge + GAP_W:
                self.y, self.vy, self.grounded = GROUND - 12.0, 0.0, False  # scrambles out
                self.takeoff = left + BODY_W / 2
                return self._stumble()
        return 0.0

    def _drop_shapes(self):
        if self.falling is None:
            if self.steps % SHAPE_EVERY == 0:
                shape = SHAPES[int(self.np_random.integers(len(SHAPES)))]
                fall = (GROUND - 10) / SHAPE_FALL  # steps until it lands, in which the stage moves on
                spot = self.run + self.speed * fall + self.np_random.integers(20, 60)
                self.falling = [int(spot) // CELL, 10.0, shape]
            return 0.0
        column, bottom, shape = self.falling
        self.falling[1] = bottom + SHAPE_FALL
        tops = [GROUND - self.height_at((column + i) * CELL) for i in range(len(shape))]
        if self.falling[1] < min(tops):
            return 0.0
        reward = 0.0
        if column * CELL < self.stage_x + BODY_W and self.stage_x < (column + len(shape)) * CELL:
            reward += self._stumble()
        for i, cells in enumerate(shape):
            if not self.over_gap((column + i) * CELL):
                self.heaps[column + i] = min(3, self.heaps.get(column + i, 0) + cells)
        self.falling = None
        return reward + self._clear_rows()

    def _clear_rows(self):
        """Eight golden trunks side by side vanish."""
        columns = sorted(self.heaps)
        for first in columns:
            row = range(first, first + ROW_FULL)
            if all(self.heaps.get(column, 0) for column in row):
                for column in row:
                    self.heaps[column] -= 1
                    if not self.heaps[column]:
                        del self.heaps[column]
                return ROW_REWARD
        return 0.0

    def _meet_phantoms(self):
        for phantom in self.phantoms:
            if phantom[1]:
                phantom[1] -= 1
                if not phantom[1]:
                    phantom[0] = self.run + SIZE + 4
                continue
            phantom[0] -= PHANTOM_SPEED
            if int(phantom[0]) in self.claimed or phantom[0] < self.run - 6:
                phantom[1] = PHANTOM_BACK
            elif abs(phantom[0] - self.stage_x) < 5 and self.y > GROUND - 8:
                phantom[1] = PHANTOM_BACK
                return self._stumble()
        return 0.0

    def _forget_the_past(self):
        self.obstacles = [entry for entry in self.obstacles if entry[1] > self.run - 20]
        edge = int(self.run) // CELL - 2
        self.heaps = {column: cells for column, cells in self.heaps.items() if column > edge}
        self.claimed = {x for x in self.claimed if x >= self.run}

    def _info(self):
        return {"is_success": self.won, "run": self.run, "lives": self.lives, "chase": self.chase}

    # -- picture ------------------------------------------------------------------------------------------------------

    def _sew_curtain(self):
        img = np.empty((SIZE, SIZE, 3), np.uint8)
        img[:] = BACKSTAGE
        img[:14] = VELVET
        img[:14, ::6] = VELVET_FOLD
        for x in range(SIZE):  # the torn hem
            img[14 : 15 + (x * 7 % 5), x] = VELVET
        img[GROUND:] = BOARD
        img[80:] = PIT
        img[79, 4::12] = img[80, 3::12] = FOOTLIGHT
        return img

    def _picture(self):
        img = self.curtain.copy()
        base = int(self.run)
        for x in range(-base % 10, SIZE, 10):
            img[GROUND:79, x] = BOARD_SEAM
        owned = [x - base for x in self.claimed if 0 <= x - base < SIZE]
        img[GROUND : GROUND + 3, owned] = CLAIMED
        for kind, left in self.obstacles:
            self._draw_obstacle(img, kind, left - base)
        for column, cells in self.heaps.items():
            self._box(img, column * CELL - base, GROUND - CELL * cells, CELL - 1, CELL * cells, GOLDEN)
        if self.falling is not None:
            column, bottom, shape = self.falling
            for i, cells in enumerate(shape):
                left = (column + i) * CELL - base
                self._box(img, left, int(bottom) - CELL * cells, CELL, CELL * cells, GOLDEN_EDGE)
                self._box(img, left, int(bottom) - CELL * cells, CELL - 1, CELL * cells - 1, GOLDEN)
        for x, away in self.phantoms:
            if not away:
                self._box(img, int(x) - base, GROUND - 8, 6, 8, GHOST)
                self._box(img, int(x) - base + 1, GROUND - 6, 1, 2, GHOST_EYES)
                self._box(img, int(x) - base + 4, GROUND - 6, 1, 2, GHOST_EYES)
        self._draw_stagehand(img)
        shadow = max(0, int(HOME_X - GIVE - self.chase + 8))
        img[30:GROUND, :shadow] //= 3
        for life in range(self.lives):
            img[2:6, 2 + 6 * life : 6 + 6 * life] = FACE
        img[2:5, 30:80] = VELVET_FOLD
        img[2:5, 30 : 30 + int(50 * min(1.0, self.run / GOAL))] = FOOTLIGHT
        return img

    def _box(self, img, left, top, width, height, ink):
        if left + width > 0:
            img[max(0, top) : top + height, max(0, left) : left + width] = ink

    def _draw_obstacle(self, img, kind, left):
        if kind == TRUNK:
            self._box(img, left, GROUND - TRUNK_H, TRUNK_W, TRUNK_H, WOOD_EDGE)
            self._box(img, left + 1, GROUND - TRUNK_H + 1, TRUNK_W - 2, 2, WOOD)
        elif kind == BEAM:
            self._box(img, left + 1, 14, 1, GROUND - 24, CHAIN)
            self._box(img, left + BEAM_W - 2, 14, 1, GROUND - 24, CHAIN)
            self._box(img, left, GROUND - BEAM_CLEAR - 6, BEAM_W, 6, BEAM_INK)
        else:
            self._box(img, left, GROUND, GAP_W, 9, PIT)

    def _draw_stagehand(self, img):
        left, feet = int(HOME_X + self.offset), int(self.y)
        tall = LOW if self.sliding else TALL
        self._box(img, left, feet - tall, BODY_W, tall, SHIRT)
        self._box(img, left + 1, feet - tall, 4, 3, FACE)
        self._box(img, left, feet - tall, BODY_W, 1, CAP)
        if self.grounded and self.steps % 6 < 3:
            self._box(img, left + 2, feet - 2, 2, 2, BOARD)

    def render(self):
        return self._picture()
