"""Winter Village: a postman who can only get from house to house by trading places with what stands there.

Three houses stand side by side. Their walls are solid, but each wall has one window, and whatever the postman sees
through it (a sledge, or a snow wolf on its round) can trade places with him. Five letters must be gathered to pay off
a debt of five gold dots. Sledges splinter and wolves run off after a few trades, so trades must not be wasted.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SCREEN = 84
FLOOR_Y = 78
ROOM_EDGES = [(0, 26), (29, 55), (58, 84)]  # inner left and right pixel of each room
WALLS = [(26, 29), (55, 58)]
WINDOW_FLOOR = (67, 78)
WINDOW_LEDGE = (55, 66)

LOW_LEDGE, HIGH_LEDGE = 66, 54
BODY_W, BODY_H = 5, 8
WALK_SPEED = 2
JUMP_HEIGHT = 14
GRAVITY = 0.5
JUMP_SPEED = float(np.sqrt(2 * GRAVITY * JUMP_HEIGHT))

TRADE_REACH = 60
TRADE_COOLDOWN = 10
DEBT = 5
MAX_STEPS = 900
SLEDGE, WOLF = 0, 1
TRADES = {SLEDGE: 2, WOLF: 3}

EVENING = (38, 48, 92)
DUSK = (62, 74, 128)
PLASTER = (70, 58, 82)
SNOW = (236, 240, 248)
SNOW_SHADE = (196, 208, 230)
TIMBER = (112, 74, 46)
TIMBER_DARK = (78, 50, 32)
WINDOW_GLOW = (250, 206, 96)
COAT = (196, 52, 48)
SKIN = (244, 206, 168)
FUR = (150, 158, 176)
FUR_DARK = (96, 104, 124)
SLATS = (226, 140, 52)
RUNNER = (60, 40, 28)
PAPER = (255, 255, 255)
SEAL = (214, 40, 60)
GOLD = (255, 196, 0)


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = spaces.Box(low=0, high=255, shape=(SCREEN, SCREEN, 3), dtype=np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    # ------------------------------------------------------------------ setup

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.debt = DEBT
        self.cooldown = 0
        self.visited = [True, False, False]
        self.won = False
        self.stranded = False

        # One window is at the height of the floor, the other at the height of the low ledges.
        floor_first = bool(self.np_random.integers(2))
        self.windows = [WINDOW_FLOOR, WINDOW_LEDGE] if floor_first else [WINDOW_LEDGE, WINDOW_FLOOR]

        self._build_ledges()
        self._place_things()
        self._place_letters()

        self.x = float(ROOM_EDGES[0][0] + 3)
        self.y = float(FLOOR_Y)  # the height of the feet
        self.vy = 0.0
        self.facing = 1
        self.grounded = True
        self.backdrop = self._paint_backdrop()
        return self._frame(), self._info()

    def _build_ledges(self):
        """Five thin ledges as [left, right, y]: a low one in each room, a high one above two of them."""
        self.ledges = []
        for left, right in ROOM_EDGES:
            start = int(self.np_random.integers(left + 3, right - 15))
            self.ledges.append([start, start + 13, LOW_LEDGE])
        for room in sorted(self.np_random.permutation(3)[:2].tolist()):
            left, right = ROOM_EDGES[room]
            start = self.ledges[room][0] + int(self.np_random.integers(-4, 5))
            start = int(np.clip(start, left + 1, right - 12))
            self.ledges.append([start, start + 11, HIGH_LEDGE])

    def _place_things(self):
        """Things are [kind, x, y, direction, trades left]. A sledge always waits behind each window."""
        self.things = []
        for room in (1, 2):
            left, right = ROOM_EDGES[room]
            if self.windows[room - 1] == WINDOW_LEDGE:
                ledge = self.ledges[room]
                x = int(self.np_random.integers(ledge[0], ledge[1] - BODY_W))
                self.things.append([SLEDGE, float(x), float(LOW_LEDGE), 0, TRADES[SLEDGE]])
            else:
                x = int(self.np_random.integers(left + 8, right - BODY_W - 2))
                self.things.append([SLEDGE, float(x), float(FLOOR_Y), 0, TRADES[SLEDGE]])
            direction = 1 if self.np_random.integers(2) else -1
            x = int(self.np_random.integers(left + 2, right - 8))
            self.things.append([WOLF, float(x), float(FLOOR_Y), direction, TRADES[WOLF]])

    def _place_letters(self):
        """One letter in each room, low or on the low ledge; the two others lie on the high ledges."""
        self.letters = []
        for room, (left, right) in enumerate(ROOM_EDGES):
            if self.np_random.random() < 0.5:
                self.letters.append([int(self.np_random.integers(left + 8, right - 6)), FLOOR_Y - 4])
            else:
                ledge = self.ledges[room]
                self.letters.append([int(self.np_random.integers(ledge[0] + 1, ledge[1] - 4)), LOW_LEDGE - 4])
        for ledge in self.ledges[3:]:
            self.letters.append([int(self.np_random.integers(ledge[0] + 1, ledge[1] - 4)), HIGH_LEDGE - 4])

    # ------------------------------------------------------------------- step

    def step(self, action):
        move, trade, _ = (int(a) for a in action)
        self.steps += 1
        reward = 0.0
        if not (self.won or self.stranded):
            self._walk(move)
            self._fall(move)
            self._roam_wolves()
            self.cooldown = max(0, self.cooldown - 1)
            if trade and self.cooldown == 0:
                self._trade_places()
            reward += self._enter_room() + self._gather()
            if self.debt == 0 and all(self.visited):
                self.won = True
                reward += 5.0
            elif self._is_stranded():
                self.stranded = True
                reward -= 2.0
        terminated = self.won or self.stranded
        truncated = self.steps >= MAX_STEPS and not terminated
        return self._frame(), float(reward), terminated, truncated, self._info()

    def room_of(self, x):
        centre = x + BODY_W / 2
        return 0 if centre < WALLS[0][1] else 1 if centre < WALLS[1][1] else 2

    def _walk(self, move):
        if move in (3, 4):
            self.facing = -1 if move == 3 else 1
            left, right = ROOM_EDGES[self.room_of(self.x)]
            self.x = float(np.clip(self.x + WALK_SPEED * self.facing, left, right - BODY_W))

    def _support(self, old_y, new_y):
        """The highest surface between two heights of the feet, or None."""
        best = FLOOR_Y if new_y >= FLOOR_Y else None
        for left, right, top in self.ledges:
            if self.x + BODY_W > left and self.x < right and old_y <= top <= new_y:
                best = top if best is None else min(best, top)
        return best

    def _fall(self, move):
        if self.grounded:
            if move == 1:
                self.vy = -JUMP_SPEED
            elif move == 2 and self.y < FLOOR_Y:
                self.y += 1.0
            elif self._support(self.y, self.y) is not None:
                return
            self.grounded = False
        old = self.y
        self.y += self.vy + 0.5 * GRAVITY
        self.vy = min(self.vy + GRAVITY, 4.0)
        support = self._support(old, self.y) if self.vy > 0 else None
        if support is not None:
            self.y, self.vy, self.grounded = float(support), 0.0, True

    def _roam_wolves(self):
        for thing in self.things:
            kind, x, y, direction, _ = thing
            if kind == SLEDGE:
                continue
            thing[2] = min(float(FLOOR_Y), y + 2.0)
            if self.steps % 3 == 0:
                left, right = ROOM_EDGES[self.room_of(x)]
                thing[1] = float(np.clip(x + direction, left, right - BODY_W))
                if not left < thing[1] < right - BODY_W:
                    thing[3] = -direction

    def sees(self, thing):
        """Whether a thing stands in the line of sight of the way that the postman faces."""
        gap = (thing[1] - self.x) * self.facing
        if not 0 < gap <= TRADE_REACH or abs(thing[2] - self.y) > 4:
            return False
        for wall, (top, bottom) in zip(WALLS, self.windows):
            between = min(self.x, thing[1]) < wall[0] < max(self.x, thing[1])
            if between and not (top < self.y <= bottom and top < thing[2] <= bottom):
                return False
        return True

    def _trade_places(self):
        seen = [thing for thing in self.things if self.sees(thing)]
        if not seen:
            return
        thing = min(seen, key=lambda other: abs(other[1] - self.x))
        self.x, thing[1] = thing[1], self.x
        self.y, thing[2] = thing[2], self.y
        self.vy, self.grounded = 0.0, False
        self.cooldown = TRADE_COOLDOWN
        thing[4] -= 1
        if thing[4] == 0:
            self.things.remove(thing)

    def _enter_room(self):
        room = self.room_of(self.x)
        if self.visited[room]:
            return 0.0
        self.visited[room] = True
        return 1.0

    def _gather(self):
        before = len(self.letters)
        self.letters = [
            [x, y]
            for x, y in self.letters
            if not (self.x - 4 < x < self.x + BODY_W and self.y - BODY_H - 3 < y < self.y)
        ]
        gained = before - len(self.letters)
        self.debt -= gained
        return float(gained)

    def _is_stranded(self):
        """Nothing stands in another room, though there is something left to do in one."""
        here = self.room_of(self.x)
        business = not all(self.visited) or any(self.room_of(letter[0]) != here for letter in self.letters)
        return business and all(self.room_of(thing[1]) == here for thing in self.things)

    def _info(self):
        return {"is_success": self.won, "debt": self.debt, "letters": len(self.letters), "stranded": self.stranded}

    # ---------------------------------------------------------------- drawing

    def _paint_backdrop(self):
        img = np.empty((SCREEN, SCREEN, 3), np.uint8)
        img[:] = EVENING
        img[30:] = DUSK
        for left, right in ROOM_EDGES:
            img[34:FLOOR_Y, left:right] = PLASTER
            middle = (left + right) // 2
            for row in range(13):  # a gable with snow along its edges
                img[21 + row, middle - 1 - row : middle + 1 + row] = TIMBER
                img[21 + row, [middle - 1 - row, middle + row]] = SNOW
            img[26:31, middle - 2 : middle + 2] = WINDOW_GLOW
        img[FLOOR_Y:] = SNOW
        img[FLOOR_Y + 2 :: 3, ::7] = SNOW_SHADE
        for (left, right), (top, bottom) in zip(WALLS, self.windows):
            img[32:FLOOR_Y, left:right] = TIMBER
            img[32:FLOOR_Y:4, left:right] = TIMBER_DARK
            img[top:bottom, left:right] = WINDOW_GLOW
        for left, right, top in self.ledges:
            img[top : top + 2, left:right] = TIMBER
            img[top, left:right] = SNOW
        flakes = self.np_random.integers(0, (20, SCREEN), size=(24, 2))
        img[flakes[:, 0], flakes[:, 1]] = SNOW_SHADE
        return img

    def _frame(self):
        img = self.backdrop.copy()
        for x, y in self.letters:
            img[y : y + 3, x : x + 4] = PAPER
            img[y + 1, x + 1 : x + 3] = SEAL
        for kind, x, y, direction, left in self.things:
            column, row = int(x), int(y)
            if kind == SLEDGE:
                img[row - 4 : row - 2, column : column + 6] = SLATS
                img[row - 1, column : column + 6] = RUNNER
                img[row - 6 : row - 4, column : column + 2] = SLATS if left > 1 else RUNNER
            else:
                img[row - 5 : row - 2, column : column + 6] = FUR
                img[row - 2 : row, column : column + 6 : 4] = FUR_DARK
                head = column + 5 if direction > 0 else column
                img[row - 7 : row - 4, max(0, head - 1) : head + 2] = FUR_DARK
        x, y = int(self.x), int(self.y)
        img[y - 5 : y, x : x + BODY_W] = COAT
        img[y - 8 : y - 5, x + 1 : x + 4] = SKIN
        img[y - 8, x : x + BODY_W] = TIMBER_DARK
        img[y - 7, x + 3 if self.facing > 0 else x + 1] = RUNNER
        for dot in range(DEBT):  # what is still owed, along the upper edge
            img[3:7, 4 + 7 * dot : 8 + 7 * dot] = GOLD if dot < self.debt else DUSK
        img[4:6, 60 : 60 + 2 * (TRADE_COOLDOWN - self.cooldown)] = WINDOW_GLOW
        return img

    def render(self):
        return self._frame()
