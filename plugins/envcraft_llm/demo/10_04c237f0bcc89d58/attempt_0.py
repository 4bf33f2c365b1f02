"""Steam Laundry: table hockey on a wet cellar floor against a cloud of steam.

The laundress keeps her mallet in the lower half and shoots at the goal on top; the steam cloud does the opposite.
While button one is held the puck sticks to her mallet for up to six steps and leaves it upwards when let go, turned
by the way she moves. Five copper bumpers throw everything back. Washing baskets scroll through from right to left and
may squeeze the mallet against the wall. Two goals decide the match.
"""

import math

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
TOP = 6
STEP_LIMIT = 1000
LIVES = 3
GOALS = 2

LEFT, RIGHT = 4.0, 79.0
CEILING, FLOOR = TOP + 3.0, 80.0
MIDDLE = 44.0
GOAL_WIDTH = 20
GOAL_LEFT, GOAL_RIGHT = 42 - GOAL_WIDTH / 2, 42 + GOAL_WIDTH / 2

MALLET_SPEED = 2.0
MALLET_RADIUS, PUCK_RADIUS = 4.0, 2.0
MALLET_START = (22.0, 70.0)
HOLD_STEPS = 6
SHOT_SPEED = 4.0
DRAG = 0.97
SERVE_SPEED = 4.2

CLOUD_SPEED = 0.4
CLOUD_SHOT = 2.8
CLOUD_HOME = (42.0, 14.0)

BUMPERS = ((14.0, 30.0), (70.0, 30.0), (11.0, 52.0), (73.0, 52.0), (23.0, 20.0))
BUMPER_RADIUS = 3.0
BUMPER_KICK = 3.0
LIT_REWARD = 0.5

SCROLL_EVERY = 4
BASKET_EVERY = 130
BASKET = (7, 8)

STONE = (74, 80, 88)
STONE_WET = (62, 70, 82)
STEAM = (232, 238, 242)
STEAM_SHADE = (190, 202, 212)
SOAP = (90, 170, 240)
SOAP_DARK = (50, 110, 180)
COPPER = (196, 108, 58)
COPPER_LIT = (255, 190, 110)
WICKER = (170, 138, 86)
PUCK = (250, 250, 120)
RIM = (120, 66, 38)
MOVES = {0: (0, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

# Filled circles by radius, as masks.
DISCS = {r: np.add.outer(np.arange(-r, r + 1) ** 2, np.arange(-r, r + 1) ** 2) <= r * r + 1 for r in (2, 3, 4, 5)}


class GameEnv(gym.Env):
    """First to two goals, with baskets in the way."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.table = self._paint_table()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.scored = self.let_in = 0
        self.mallet = list(MALLET_START)
        self.cloud = list(CLOUD_HOME)
        self.cloud_rest = 0
        self.hold_left = HOLD_STEPS
        self.holding = False
        self.lit = [False] * len(BUMPERS)
        self.baskets = []
        self._serve()
        return self._paint(), self._info()

    def _serve(self):
        """The puck comes in at the middle of the table, towards the laundress."""
        self.puck = [42.0, MIDDLE]
        aim = float(self.np_random.uniform(GOAL_LEFT + 4, GOAL_RIGHT - 4))
        dx, dy = aim - self.puck[0], FLOOR - self.puck[1]
        reach = math.hypot(dx, dy)
        self.speed = [SERVE_SPEED * dx / reach, SERVE_SPEED * dy / reach]
        self.holding = False

    # -- one step ----------------------------------------------------------------

    def step(self, action):
        reward = 0.0
        if not self._over():
            self.steps += 1
            way = MOVES[int(action[0])]
            self._move_mallet(way)
            reward += self._scroll()
            self._hold(bool(action[1]), way)
            if not self.holding:
                reward += self._glide()
                self._strike(way)
            self._move_cloud()
            reward += self._count_goals()
        terminated = self._over()
        truncated = self.steps >= STEP_LIMIT and not terminated
        return self._paint(), float(reward), terminated, truncated, self._info()

    def _over(self):
        return self.scored >= GOALS or self.let_in >= GOALS or self.lives <= 0

    def _move_mallet(self, way):
        x, y = self.mallet[0] + MALLET_SPEED * way[0], self.mallet[1] + MALLET_SPEED * way[1]
        x = min(max(x, LEFT + MALLET_RADIUS), RIGHT - MALLET_RADIUS)
        y = min(max(y, MIDDLE + MALLET_RADIUS), FLOOR - MALLET_RADIUS)
        if not any(self._in_basket(x, y, basket) for basket in self.baskets):
            self.mallet = [x, y]

    @staticmethod
    def _in_basket(x, y, basket, margin=3.0):
        left, top = basket
        return left - margin < x < left + BASKET[0] + margin and top - margin < y < top + BASKET[1] + margin

    def _scroll(self):
        """Baskets go left by a pixel every four steps and push the mallet before them."""
        if self.steps % BASKET_EVERY == 0:
            self.baskets.append([float(SIZE), float(self.np_random.integers(50, 66))])
        if self.steps % SCROLL_EVERY:
            return 0.0
        for basket in self.baskets:
            basket[0] -= 1.0
        self.baskets = [basket for basket in self.baskets if basket[0] > -BASKET[0]]
        for basket in self.baskets:
            if self._in_basket(*self.mallet, basket):
                self.mallet[0] = basket[0] - 3.0
                if self.mallet[0] < LEFT + MALLET_RADIUS:
                    self.lives -= 1
                    self.mallet = list(MALLET_START)
                    self.baskets = [other for other in self.baskets if other is not basket]
                    return -1.0
        return 0.0

    def _hold(self, pressed, way):
        gap = math.hypot(self.puck[0] - self.mallet[0], self.puck[1] - self.mallet[1])
        near = gap < MALLET_RADIUS + PUCK_RADIUS + 2
        if pressed and (self.holding or near) and self.hold_left:
            self.holding = True
            self.hold_left -= 1
            self.puck = [self.mallet[0], max(self.mallet[1] - MALLET_RADIUS - PUCK_RADIUS, CEILING)]
            self.speed = [0.0, 0.0]
            return
        if self.holding:
            self.holding = False
            self.speed = [1.6 * way[0], -SHOT_SPEED]
        if not near:
            self.hold_left = HOLD_STEPS

    def _glide(self):
        self.speed = [DRAG * part for part in self.speed]
        self.puck[0] += self.speed[0]
        self.puck[1] += self.speed[1]
        in_goal = GOAL_LEFT < self.puck[0] < GOAL_RIGHT
        if not LEFT + PUCK_RADIUS < self.puck[0] < RIGHT - PUCK_RADIUS:
            self.puck[0] = min(max(self.puck[0], LEFT + PUCK_RADIUS), RIGHT - PUCK_RADIUS)
            self.speed[0] = -self.speed[0]
        if not in_goal and not CEILING < self.puck[1] < FLOOR - PUCK_RADIUS:
            self.puck[1] = min(max(self.puck[1], CEILING), FLOOR - PUCK_RADIUS)
            self.speed[1] = -self.speed[1]
        for basket in self.baskets:
            if self._in_basket(*self.puck, basket, margin=PUCK_RADIUS):
                self.puck[0] = basket[0] - PUCK_RADIUS if self.speed[0] > 0 else basket[0] + BASKET[0] + PUCK_RADIUS
                self.speed[0] = -self.speed[0]
                self.puck[0] = min(max(self.puck[0], LEFT + PUCK_RADIUS), RIGHT - PUCK_RADIUS)
        return self._bounce_off_bumpers()

    def _bounce_off_bumpers(self):
        for number, (bx, by) in enumerate(BUMPERS):
            dx, dy = self.puck[0] - bx, self.puck[1] - by
            gap = math.hypot(dx, dy)
            if 0 < gap < BUMPER_RADIUS + PUCK_RADIUS:
                reach = BUMPER_RADIUS + PUCK_RADIUS + 0.1
                self.puck = [bx + dx / gap * reach, by + dy / gap * reach]
                self.speed = [BUMPER_KICK * dx / gap, BUMPER_KICK * dy / gap]
                if all(self.lit):
                    self.lit = [False] * len(BUMPERS)
                    return LIT_REWARD
                self.lit[number] = True
        return 0.0

    def _strike(self, way):
        """The mallet throws the puck off along the line between their middles, harder when it moves."""
        dx, dy = self.puck[0] - self.mallet[0], self.puck[1] - self.mallet[1]
        gap = math.hypot(dx, dy) or 1.0
        if gap >= MALLET_RADIUS + PUCK_RADIUS:
            return
        hard = 2.6 if way != (0, 0) else 1.4
        reach = MALLET_RADIUS + PUCK_RADIUS
        self.puck = [self.mallet[0] + dx / gap * reach, self.mallet[1] + dy / gap * reach]
        self.speed = [hard * dx / gap, hard * dy / gap]

    def _move_cloud(self):
        """For the puck while that is in the upper half, else back in front of the goal."""
        self.cloud_rest = max(0, self.cloud_rest - 1)
        goal = self.puck if self.puck[1] < MIDDLE and not self.cloud_rest else CLOUD_HOME
        dx, dy = goal[0] - self.cloud[0], goal[1] - self.cloud[1]
        gap = math.hypot(dx, dy)
        if gap > CLOUD_SPEED:
            self.cloud[0] += CLOUD_SPEED * dx / gap
            self.cloud[1] = min(self.cloud[1] + CLOUD_SPEED * dy / gap, MIDDLE - MALLET_RADIUS)
        touching = math.hypot(self.puck[0] - self.cloud[0], self.puck[1] - self.cloud[1]) < 5
        if touching and not self.holding and not self.cloud_rest:
            turn = float(self.np_random.uniform(-0.7, 0.7))
            self.speed = [CLOUD_SHOT * math.sin(turn), CLOUD_SHOT * math.cos(turn)]
            self.cloud_rest = 15

    def _count_goals(self):
        if self.puck[1] < CEILING - 2:
            self.scored += 1
            self._serve()
            return 5.0 if self.scored >= GOALS else 2.0
        if self.puck[1] > FLOOR + 1:
            self.let_in += 1
            self._serve()
            return -2.0
        return 0.0

    def _info(self):
        won = self.scored >= GOALS
        return {"is_success": won, "scored": self.scored, "let_in": self.let_in, "lives": self.lives}

    # -- picture -----------------------------------------------------------------

    def render(self):
        return self._paint()

    @staticmethod
    def _paint_table():
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        image[:] = STONE
        yy, xx = np.indices((SIZE, SIZE))
        image[(xx * 3 + yy * 5) % 17 < 3] = STONE_WET
        image[:TOP] = (24, 28, 34)
        image[TOP : TOP + 2] = image[-3:] = RIM
        image[TOP:, :3] = image[TOP:, -4:] = RIM
        left, right = int(GOAL_LEFT), int(GOAL_RIGHT)
        image[TOP : TOP + 2, left:right] = STEAM_SHADE
        image[-3:, left:right] = SOAP_DARK
        image[int(MIDDLE), 3:-4:2] = SOAP_DARK
        return image

    @staticmethod
    def _disc(image, centre, radius, colour):
        column, row = int(centre[0] + 0.5), int(centre[1] + 0.5)
        mask = DISCS[int(radius)]
        image[row - len(mask) // 2 :, column - len(mask) // 2 :][: len(mask), : len(mask)][mask] = colour

    def _paint(self):
        image = self.table.copy()
        for centre, lit in zip(BUMPERS, self.lit):
            self._disc(image, centre, BUMPER_RADIUS, COPPER_LIT if lit else COPPER)
        for left, top in self.baskets:
            column, row = int(left), int(top)
            image[row : row + BASKET[1], max(0, column) : max(0, column + BASKET[0])] = WICKER
            image[row + 1 : row + BASKET[1] : 3, max(0, column) : max(0, column + BASKET[0])] = RIM
        self._disc(image, self.cloud, 5, STEAM_SHADE)
        self._disc(image, (self.cloud[0] - 1, self.cloud[1] - 1), 3, STEAM)
        self._disc(image, self.mallet, MALLET_RADIUS, SOAP_DARK)
        self._disc(image, self.mallet, 2, SOAP)
        self._disc(image, self.puck, PUCK_RADIUS, PUCK)
        for life in range(self.lives):
            image[1:4, 2 + 5 * life : 6 + 5 * life] = SOAP
        for goal in range(GOALS):
            image[1:4, 40 + 5 * goal : 44 + 5 * goal] = PUCK if goal < self.scored else STONE
            image[1:4, 70 + 5 * goal : 74 + 5 * goal] = STEAM if goal < self.let_in else STONE
        return image
