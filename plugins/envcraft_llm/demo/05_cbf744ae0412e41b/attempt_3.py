"""Deep-sea Trench: teach four companions to fetch ore by praising and scolding them.

Each companion always does one of three things: it fetches a nodule of ore for the support ship, guards against
anglerfish, or follows the submersible. When a task is over it picks the next one by its own weights. Praise (button
one) doubles, scolding (button two) halves the weight of what a companion within earshot is doing. Pressing too often
tires the pilot: after eight presses within fifty steps neither button works for twenty steps.
"""

from dataclasses import dataclass, field

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
STEP_LIMIT = 950
GOAL = 16
SPEED = 1.5
COMPANIONS = 4
COMPANION_SPEED = 0.9
EARSHOT = 26.0
CALL_PAUSE = 8
PRESSES, PRESS_WINDOW, TIRED_STEPS = 8, 50, 20
ANGLER_EVERY = 80
ANGLER_SPEED = 0.45
TASK_STEPS = 60
NODULES = 7
SHIP = np.array([42.0, 12.0])
FETCH, GUARD, FOLLOW = range(3)

ABYSS = (6, 8, 20)
TRENCH = (12, 18, 36)
VENT = (220, 70, 40)
HULL = (250, 210, 60)
GLASS = (120, 220, 255)
ORE = (190, 170, 150)
SHIP_GREY = (170, 180, 190)
ANGLER = (200, 50, 90)
LURE = (255, 255, 160)
HABIT_COLOURS = ((70, 255, 140), (255, 120, 60), (90, 150, 255))
PAD = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


@dataclass
class Companion:
    """One of the pack: where it is, what it does, and how likely it is to choose each habit."""

    at: np.ndarray
    habit: int = FOLLOW
    left: int = 20
    carrying: bool = False
    weights: np.ndarray = field(default_factory=lambda: np.ones(3))


class GameEnv(gym.Env):
    """Sixteen nodules, four opinions."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
    #: Painted once, because painting the sea bed at every reset is slow.
    backdrop = None

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.sub = np.array([42.0, 44.0])
        self.facing = (0, -1)
        self.fetched = 0
        self.pack = [Companion(self.sub + self.np_random.uniform(-14, 14, 2)) for _ in range(COMPANIONS)]
        self.nodules = [self._sea_bed() for _ in range(NODULES)]
        self.anglers = []
        self.call_wait = 0
        self.presses = []
        self.tired = 0
        self.called = None
        if GameEnv.backdrop is None:
            GameEnv.backdrop = self._paint_backdrop()
        return self._draw(), self._info()

    def _sea_bed(self):
        return np.array([self.np_random.uniform(6, SIZE - 6), self.np_random.uniform(50, SIZE - 6)])

    # -- the pilot -------------------------------------------------------------

    def step(self, action):
        move, praise, scold = int(action[0]), int(action[1]), int(action[2])
        reward = 0.0
        if not self._over():
            self.steps += 1
            if move in PAD:
                self.facing = PAD[move]
                self.sub = np.clip(self.sub + SPEED * np.array(PAD[move]), 5.0, SIZE - 6.0)
            self._call(praise, scold)
            reward += self._run_pack()
            reward += self._run_anglers()
            if self._over():
                reward += 5.0 if self.fetched >= GOAL else -2.0
        terminated = self._over()
        truncated = self.steps >= STEP_LIMIT and not terminated
        return self._draw(), float(reward), terminated, truncated, self._info()

    def _over(self):
        return self.fetched >= GOAL or len(self.pack) < 2

    def _call(self, praise, scold):
        """Praise or scold whoever is near enough to hear it, unless the pilot is out of breath."""
        self.called = None
        self.call_wait = max(0, self.call_wait - 1)
        self.tired = max(0, self.tired - 1)
        if not (praise or scold) or self.tired:
            return
        self.presses = [step for step in self.presses if self.steps - step < PRESS_WINDOW] + [self.steps]
        if len(self.presses) >= PRESSES:
            self.tired = TIRED_STEPS
            self.presses = []
            return
        if self.call_wait:
            return
        self.call_wait = CALL_PAUSE
        self.called = "praise" if praise else "scold"
        for companion in self.pack:
            if np.linalg.norm(companion.at - self.sub) <= EARSHOT:
                companion.weights[companion.habit] *= 2.0 if praise else 0.5

    # -- the pack --------------------------------------------------------------

    def _choose_habit(self, companion):
        odds = companion.weights / companion.weights.sum()
        return int(self.np_random.choice(3, p=odds))

    def _run_pack(self):
        reward = 0.0
        for companion in self.pack:
            companion.left -= 1
            if companion.left <= 0 and not companion.carrying:
                companion.habit = self._choose_habit(companion)
                companion.left = TASK_STEPS
            if companion.habit == FETCH:
                reward += self._fetch(companion)
            elif companion.habit == GUARD:
                self._guard(companion)
            else:
                self._swim(companion, self.sub, stop=9.0)
        return reward

    def _swim(self, companion, goal, stop=0.0):
        way = goal - companion.at
        gap = float(np.linalg.norm(way))
        if gap > stop:
            companion.at = companion.at + way / gap * min(COMPANION_SPEED, gap)
        return gap

    def _fetch(self, companion):
        if companion.carrying:
            if self._swim(companion, SHIP) < 5:
                companion.carrying = False
                companion.left = 0
                self.fetched += 1
                return 1.0
            return 0.0
        nearest = min(range(len(self.nodules)), key=lambda n: float(np.linalg.norm(self.nodules[n] - companion.at)))
        if self._swim(companion, self.nodules[nearest]) < 3:
            self.nodules[nearest] = self._sea_bed()
            companion.carrying = True
        return 0.0

    def _guard(self, companion):
        if not self.anglers:
            self._swim(companion, np.array([42.0, 34.0]), stop=6.0)
            return
        nearest = min(range(len(self.anglers)), key=lambda n: float(np.linalg.norm(self.anglers[n] - companion.at)))
        if self._swim(companion, self.anglers[nearest]) < 4:
            del self.anglers[nearest]
            companion.left = 0

    def _run_anglers(self):
        """Anglerfish come up from the trench; one that reaches a companion scares it away, and leaves."""
        if self.steps % ANGLER_EVERY == 0:
            self.anglers.append(np.array([self.np_random.uniform(8, SIZE - 8), SIZE - 4.0]))
        reward = 0.0
        for number in reversed(range(len(self.anglers))):
            prey = min(self.pack, key=lambda c: float(np.linalg.norm(c.at - self.anglers[number])))
            way = prey.at - self.anglers[number]
            gap = float(np.linalg.norm(way))
            if gap < 3 and prey.habit != GUARD:
                self.pack = [companion for companion in self.pack if companion is not prey]
                del self.anglers[number]
                reward -= 1.0
                if len(self.pack) < 2:
                    break
            elif gap > 0:
                self.anglers[number] = self.anglers[number] + way / gap * ANGLER_SPEED
        return reward

    def _info(self):
        return {"is_success": self.fetched >= GOAL, "fetched": self.fetched, "companions": len(self.pack)}

    # -- picture ---------------------------------------------------------------

    def render(self):
        return self._draw()

    def _paint_backdrop(self):
        sea = np.empty((SIZE, SIZE, 3), np.uint8)
        sea[:] = ABYSS
        bed = 70 + np.cumsum(self.np_random.integers(-1, 2, size=SIZE)).clip(-8, 8)
        sea[np.arange(SIZE)[:, None] >= bed[None, :]] = TRENCH
        for column in self.np_random.integers(4, SIZE - 4, size=3).tolist():
            sea[SIZE - 6 :, column : column + 2] = VENT
        sea[10:14, 30:55] = SHIP_GREY
        sea[7:10, 38:46] = SHIP_GREY
        return sea

    @staticmethod
    def _dot(sea, at, half, colour):
        column, row = int(at[0]), int(at[1])
        sea[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1] = colour

    def _draw(self):
        sea = self.backdrop.copy()
        for nodule in self.nodules:
            self._dot(sea, nodule, 1, ORE)
        for angler in self.anglers:
            self._dot(sea, angler, 2, ANGLER)
            self._dot(sea, angler - (0, 4), 0, LURE)
        for companion in self.pack:
            self._dot(sea, companion.at, 1, HABIT_COLOURS[companion.habit])
            if companion.carrying:
                self._dot(sea, companion.at + (0, 2), 0, ORE)
        column, row = int(self.sub[0]), int(self.sub[1])
        sea[row - 2 : row + 3, column - 3 : column + 4] = HULL
        sea[row + self.facing[1], column + 2 * self.facing[0]] = GLASS
        if self.called:
            sea[row - 4, column - 4 : column + 5] = HABIT_COLOURS[0 if self.called == "praise" else 1]
        breath = 0 if self.tired else PRESSES - len(self.presses)
        sea[max(0, row - 5), max(0, column - 4) : max(0, column - 4) + breath] = GLASS
        for number in range(GOAL):
            sea[1:4, 2 + 5 * number : 5 + 5 * number] = ORE if number < self.fetched else TRENCH
        return sea
