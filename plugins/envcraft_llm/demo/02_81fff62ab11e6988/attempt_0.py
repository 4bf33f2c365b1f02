"""Swamp: a frog fetches four fireflies out of walled thickets through two pairs of portals.

One portal of each pair lies on the reed island in the middle, the other one in a thicket; every hundred steps the
latter jumps to the pair's other thicket. Storks land where a portal and a firefly are, walk through the portal to the
island and hunt the frog. Each wound makes the frog forty percent faster and the storks twenty percent.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
BAR = 5
STEPS = 900

FROG_SPEED = 1.0
FASTER_FROG = 1.4
STORK_SPEED = 0.42
FASTER_STORK = 1.2
LIVES = 4
UNHURT_STEPS = 30

PORTAL_REST = 20
PORTAL_MOVE = 100
PORTAL_REACH = 3.0

FIREFLIES = 4
STRAYED = 6
STORK_EVERY = 80
STORK_STAYS = 160
STORKS_AT_ONCE = 3

BOG = np.array((66, 50, 34), np.uint8)
BOG_LIGHT = np.array((82, 64, 42), np.uint8)
LILY = (62, 120, 54)
LILY_DARK = (40, 84, 40)
BARK = (36, 26, 20)
MIST = (186, 192, 186)
REED = (148, 140, 70)
FIREFLY = (255, 240, 110)
GLOW = (150, 140, 60)
FROG = (120, 230, 80)
FROG_EYE = (20, 40, 10)
STORK = (250, 250, 250)
BEAK = (230, 80, 50)
PAIR = ((80, 200, 255), (255, 120, 210))
SHUT = (70, 70, 84)

# Thickets in the four corners: left, top, right, bottom of the space inside their walls.
THICKETS = ((3, 9, 25, 29), (58, 9, 80, 29), (3, 59, 25, 80), (58, 59, 80, 80))
# The thickets that the far portal of each pair visits in turn.
HOMES = ((0, 3), (1, 2))
ISLAND_PORTALS = ((31.0, 44.0), (53.0, 44.0))
STEP = {0: (0, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    """Portals for everyone: the frog's way in is the storks' way out."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.solid = self._build_walls()

    @staticmethod
    def _build_walls():
        solid = np.zeros((SIZE, SIZE), bool)
        for left, top, right, bottom in THICKETS:
            solid[top - 2 : bottom + 3, left - 2 : right + 3] = True
            solid[top : bottom + 1, left : right + 1] = False
        solid[: BAR + 1] = solid[-1:] = True
        solid[:, :1] = solid[:, -1:] = True
        return solid

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        self.frog = [42.0, 60.0 + float(self.np_random.integers(0, 8))]
        self.facing = (0, -1)
        self.wounds = 0
        self.unhurt = 0
        self.carrying = False
        self.brought = 0
        self.strayed = 0
        self.turn = int(self.np_random.integers(0, 2))
        self.far = [self._spot_in(HOMES[pair][self.turn]) for pair in (0, 1)]
        self.rest = [0, 0]
        self.flies = [self._spot_in(number) for number in range(FIREFLIES)]
        self.storks = []
        self.swamp = self._paint_swamp()
        return self._paint(), self._info()

    def _spot_in(self, thicket):
        left, top, right, bottom = THICKETS[thicket]
        return [
            float(self.np_random.integers(left + 4, right - 3)),
            float(self.np_random.integers(top + 4, bottom - 3)),
        ]

    # -- where things are ------------------------------------------------------

    @staticmethod
    def region(x, y):
        """The thicket that a point lies in, or None for open water."""
        for number, (left, top, right, bottom) in enumerate(THICKETS):
            if left <= x <= right and top <= y <= bottom:
                return number
        return None

    def home(self, pair):
        """The thicket in which the far portal of this pair is now."""
        return HOMES[pair][self.turn]

    @property
    def frog_speed(self):
        return FROG_SPEED * FASTER_FROG**self.wounds

    @property
    def stork_speed(self):
        return STORK_SPEED * FASTER_STORK**self.wounds

    def _free(self, x, y, half=1):
        return not self.solid[int(y) - half : int(y) + half + 1, int(x) - half : int(x) + half + 1].any()

    def _slide(self, thing, dx, dy):
        if dx and self._free(thing[0] + dx, thing[1]):
            thing[0] += dx
        if dy and self._free(thing[0], thing[1] + dy):
            thing[1] += dy

    # -- one step --------------------------------------------------------------

    def step(self, action):
        over = self.brought >= FIREFLIES or self.wounds >= LIVES or self.strayed >= STRAYED
        reward = 0.0
        if not over:
            self.t += 1
            reward = self._play(int(action[0]))
        won = self.brought >= FIREFLIES
        lost = not won and (self.wounds >= LIVES or self.strayed >= STRAYED)
        if lost and not over:
            reward -= 1.0
        truncated = self.t >= STEPS and not (won or lost)
        return self._paint(), float(reward), won or lost, truncated, self._info()

    def _play(self, move):
        reward = 0.0
        self.unhurt = max(0, self.unhurt - 1)
        self.rest = [max(0, rest - 1) for rest in self.rest]
        if self.t % PORTAL_MOVE == 0:
            self.turn = 1 - self.turn
            self.far = [self._spot_in(self.home(pair)) for pair in (0, 1)]
        dx, dy = STEP[move]
        if move:
            self.facing = (dx, dy)
        self._slide(self.frog, dx * self.frog_speed, dy * self.frog_speed)
        came_out = self._use_portal(self.frog)
        reward += self._handle_fireflies(came_out)
        reward += self._move_storks()
        return reward

    def _use_portal(self, thing):
        """Carry a thing through the portal it stands in; True when it comes out on the island."""
        for pair in (0, 1):
            if self.rest[pair]:
                continue
            for here, there, outward in (
                (ISLAND_PORTALS[pair], self.far[pair], False),
                (self.far[pair], ISLAND_PORTALS[pair], True),
            ):
                if abs(thing[0] - here[0]) < PORTAL_REACH and abs(thing[1] - here[1]) < PORTAL_REACH:
                    thing[0], thing[1] = there
                    self.rest[pair] = PORTAL_REST
                    return outward
        return False

    def _handle_fireflies(self, came_out):
        if came_out and self.carrying:
            self.carrying = False
            self.brought += 1
            return 2.0 if self.brought < FIREFLIES else 5.0
        if self.carrying:
            return 0.0
        for number, fly in enumerate(self.flies):
            if fly and abs(fly[0] - self.frog[0]) < 4 and abs(fly[1] - self.frog[1]) < 4:
                self.flies[number] = None
                self.carrying = True
                return 0.5
        return 0.0

    def _move_storks(self):
        if self.t % STORK_EVERY == 0 and len(self.storks) < STORKS_AT_ONCE:
            self._land_stork()
        reward = 0.0
        for stork in list(self.storks):
            self._walk(stork)
            if self._use_portal(stork):
                self.strayed += 1
                reward -= 0.2
            stork[2] -= 1
            if stork[2] <= 0:
                self.storks.remove(stork)
            elif not self.unhurt and abs(stork[0] - self.frog[0]) < 4 and abs(stork[1] - self.frog[1]) < 4:
                self.storks.remove(stork)
                self.wounds += 1
                self.unhurt = UNHURT_STEPS
                reward -= 1.0
        return reward

    def _land_stork(self):
        """A stork comes down in a thicket that has both a portal and a firefly."""
        places = [self.home(pair) for pair in (0, 1) if self.flies[self.home(pair)]]
        if places:
            place = places[int(self.np_random.integers(len(places)))]
            spot = self._spot_in(place)
            self.storks.append([spot[0], spot[1], STORK_STAYS])

    def _walk(self, stork):
        """Towards the frog where they share water; otherwise to the portal out of the thicket."""
        place = self.region(stork[0], stork[1])
        goal = self.frog
        if place is not None and place != self.region(*self.frog):
            pair = next((pair for pair in (0, 1) if self.home(pair) == place), None)
            if pair is None:
                return
            goal = self.far[pair]
        dx, dy = goal[0] - stork[0], goal[1] - stork[1]
        gap = max(abs(dx), abs(dy), 1.0)
        self._slide(stork, self.stork_speed * dx / gap, self.stork_speed * dy / gap)

    def _info(self):
        return {
            "is_success": self.brought >= FIREFLIES,
            "brought": self.brought,
            "strayed": self.strayed,
            "lives": LIVES - self.wounds,
        }

    # -- picture ---------------------------------------------------------------

    def render(self):
        return self._paint()

    def _paint_swamp(self):
        frame = np.empty((SIZE, SIZE, 3), np.uint8)
        frame[:] = BOG
        ripple = self.np_random.random((SIZE, SIZE // 4)) < 0.12
        frame[np.repeat(ripple, 4, axis=1)] = BOG_LIGHT
        yy, xx = np.ogrid[:SIZE, :SIZE]
        frame[((xx - 42) / 17) ** 2 + ((yy - 44) / 8) ** 2 <= 1] = REED
        for x, y in self.np_random.integers(30, 54, size=(7, 2)):
            row = int(y) if y < 34 else int(y) + 24
            pad = (xx - int(x)) ** 2 + (yy - row) ** 2 <= 5
            frame[pad] = LILY_DARK
        frame[self.solid] = BARK
        frame[::3, ::2][self.solid[::3, ::2]] = LILY_DARK
        frame[:BAR] = (20, 16, 12)
        return frame

    def _paint(self):
        frame = self.swamp.copy()
        for pair in (0, 1):
            colour = SHUT if self.rest[pair] else PAIR[pair]
            for x, y in (ISLAND_PORTALS[pair], self.far[pair]):
                self._ring(frame, int(x), int(y), colour)
        blink = 1 if self.t % 10 < 5 else 2
        for fly in self.flies:
            if fly:
                x, y = int(fly[0]), int(fly[1])
                frame[y - blink : y + blink + 1, x - blink : x + blink + 1] = GLOW
                frame[y - 1 : y + 1, x - 1 : x + 1] = FIREFLY
        for x, y, _ in self.storks:
            column, row = int(x), int(y)
            frame[row - 2 : row + 2, column - 1 : column + 2] = STORK
            frame[row - 1, column + 1 : column + 4] = BEAK
        self._draw_frog(frame)
        self._draw_bar(frame)
        return frame

    @staticmethod
    def _ring(frame, x, y, colour):
        frame[y - 3 : y + 4, x - 3 : x + 4][[0, -1]] = colour
        frame[y - 3 : y + 4, x - 3] = colour
        frame[y - 3 : y + 4, x + 3] = colour

    def _draw_frog(self, frame):
        if self.unhurt % 4 >= 2:
            return
        x, y = int(self.frog[0]), int(self.frog[1])
        frame[y - 1 : y + 2, x - 2 : x + 3] = FROG
        frame[y - 2, x - 1 : x + 2] = FROG
        dx, dy = self.facing
        frame[y + dy, x + dx] = FROG_EYE
        if self.carrying:
            frame[y - 3, x - 1 : x + 2] = FIREFLY

    def _draw_bar(self, frame):
        for life in range(LIVES - self.wounds):
            frame[1:4, 2 + 5 * life : 5 + 5 * life] = FROG
        for number in range(FIREFLIES):
            frame[1:4, 30 + 5 * number : 33 + 5 * number] = FIREFLY if number < self.brought else BARK
        for number in range(self.strayed):
            frame[1:4, 56 + 4 * number : 58 + 4 * number] = MIST
