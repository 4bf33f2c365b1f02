"""Night Bakery: dig eight loaves out of the dough and reach the oven before the dark does.

A board of 12 by 11 cells in the manner of the old gem-digging games. Loaves and flour sacks fall when nothing holds
them and roll off each other; whatever lands on the baker costs a life. Two caves are full of mice. Darkness creeps in
from the left and is thrown back by each loaf. Sacks can be carried to the oven, where four on top of each other earn
a bonus.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

COLS, ROWS, CELL = 12, 11, 7
TOP = 7
SIZE = 84
STEP_LIMIT = 850
LIVES = 4

GOAL = 8
SACKS, LOAVES = 14, 18
FALL_PACE = 2
MOUSE_PACE = 3
DARK_PACE = 8
DARK_BACK = 16
STACK_HEIGHT = 4
STACK_REWARD = 1.0

EMPTY, DOUGH, SACK, LOAF, OVEN = range(5)
ROUND = (SACK, LOAF)
BAKER_START = (2, 1)
OVEN_AT = (COLS - 1, ROWS - 1)
WAYS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

CREAM = (250, 238, 208)
CRUST = (176, 112, 52)
CRUST_DARK = (130, 78, 34)
EMBER = (255, 120, 40)
TILE_BLUE = (58, 92, 148)
TILE_DARK = (36, 60, 104)
FLOUR = (232, 232, 236)
FLOUR_SHADE = (180, 182, 194)
MOUSE = (120, 110, 120)
MOUSE_EAR = (230, 150, 160)
NIGHT = (10, 8, 22)
HAT = (255, 255, 255)
APRON = (200, 60, 70)


def make_tiles():
    """One 7 by 7 picture for each kind of cell."""
    tiles = np.zeros((5, CELL, CELL, 3), np.uint8)
    tiles[EMPTY] = TILE_BLUE
    tiles[EMPTY, 0, :] = tiles[EMPTY, :, 0] = TILE_DARK
    tiles[DOUGH] = CREAM
    tiles[DOUGH, 1::3, 2::3] = (226, 208, 168)
    tiles[[SACK, LOAF]] = tiles[EMPTY]
    tiles[SACK, 2:7, 1:6] = FLOUR
    tiles[SACK, 1, 2:5] = FLOUR_SHADE
    tiles[SACK, 6, 1:6] = FLOUR_SHADE
    tiles[LOAF, 2:6, 1:6] = CRUST
    tiles[LOAF, 3:5, 0:7] = CRUST
    tiles[LOAF, 2:5, 2::2] = CRUST_DARK
    tiles[OVEN] = CRUST_DARK
    tiles[OVEN, 1:3, 1:6] = NIGHT
    return tiles


TILES = make_tiles()


class GameEnv(gym.Env):
    """Dig, dodge, stack, hurry."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.safe = 0
        self.gathered = 0
        self.dark = 0
        self.baker = BAKER_START
        self.facing = 4
        self.carrying = False
        self.stack = 0
        self.falling = set()
        self.won = self.lost = False
        self._fill_board()
        return self._paint(), self._info()

    def _fill_board(self):
        self.grid = np.full((ROWS, COLS), DOUGH, np.int8)
        caves = [(int(self.np_random.integers(5, 8)), 2), (int(self.np_random.integers(3, 7)), 7)]
        self.mice = []
        kept = {BAKER_START, (1, 1), (3, 1), OVEN_AT, (COLS - 2, ROWS - 1), (COLS - 1, ROWS - 2)}
        for column, row in caves:
            self.grid[row : row + 2, column : column + 3] = EMPTY
            kept |= {(c, r) for c in range(column - 1, column + 4) for r in range(row - 1, row + 3)}
            self.mice.append({"at": (column + 1, row), "way": int(self.np_random.integers(1, 5))})
        for column, row in (BAKER_START, (1, 1), (3, 1)):
            self.grid[row, column] = EMPTY
        self.grid[OVEN_AT[1], OVEN_AT[0]] = OVEN
        free = [(c, r) for r in range(ROWS - 1) for c in range(COLS) if (c, r) not in kept]
        order = self.np_random.permutation(len(free))
        for number, index in enumerate(order[: SACKS + LOAVES].tolist()):
            column, row = free[index]
            self.grid[row, column] = SACK if number < SACKS else LOAF

    # ---- rules

    @staticmethod
    def _inside(cell):
        return 0 <= cell[0] < COLS and 0 <= cell[1] < ROWS

    def at(self, cell):
        return int(self.grid[cell[1], cell[0]]) if self._inside(cell) else OVEN

    def _set(self, cell, kind):
        self.grid[cell[1], cell[0]] = kind

    def step(self, action):
        move, reach_out = int(action[0]), bool(action[1])
        reward = 0.0
        if not (self.won or self.lost):
            self.steps += 1
            self.safe = max(0, self.safe - 1)
            if move:
                self.facing = move
                reward += self._dig(move) if reach_out else self._walk(move)
            reward += self._use_oven()
            if self.steps % FALL_PACE == 0:
                reward += self._fall()
            if self.steps % MOUSE_PACE == 0:
                self._run_mice()
            reward += self._meet_mice() + self._creep()
            self.lost = not self.won and (self.lives <= 0 or self._shut_off())
            reward += 5.0 * self.won - 1.0 * self.lost
        terminated = self.won or self.lost
        truncated = self.steps >= STEP_LIMIT and not terminated
        return self._paint(), float(reward), terminated, truncated, self._info()

    def _ahead(self, move):
        dx, dy = WAYS[move]
        return self.baker[0] + dx, self.baker[1] + dy

    def _dig(self, move):
        """Work on the neighbouring cell without stepping into it: dig dough, take a loaf, lift or set down a sack."""
        cell = self._ahead(move)
        kind = self.at(cell)
        if kind == DOUGH:
            self._set(cell, EMPTY)
        elif kind == LOAF:
            return self._gather(cell)
        elif kind == SACK and not self.carrying:
            self._set(cell, EMPTY)
            self.falling.discard(cell)
            self.carrying = True
        elif kind == EMPTY and self._inside(cell) and self.carrying:
            self._set(cell, SACK)
            self.carrying = False
        return 0.0

    def _walk(self, move):
        cell = self._ahead(move)
        kind = self.at(cell)
        if not self._inside(cell) or kind == SACK:
            return 0.0
        if kind == OVEN:
            self.won = self.gathered >= GOAL
            return 0.0
        reward = self._gather(cell) if kind == LOAF else 0.0
        self._set(cell, EMPTY)
        self.baker = cell
        return reward

    def _gather(self, cell):
        self._set(cell, EMPTY)
        self.falling.discard(cell)
        self.gathered += 1
        self.dark = max(0, self.dark - DARK_BACK)
        return 1.0 if self.gathered <= GOAL else 0.2

    def _use_oven(self):
        near = abs(self.baker[0] - OVEN_AT[0]) + abs(self.baker[1] - OVEN_AT[1]) == 1
        if not (near and self.carrying):
            return 0.0
        self.carrying = False
        self.stack += 1
        if self.stack < STACK_HEIGHT:
            return 0.0
        self.stack = 0
        return STACK_REWARD

    def _open(self, cell):
        return self.at(cell) == EMPTY

    def _fall(self):
        """Everything round without support moves down a cell, or sideways off something round."""
        reward = 0.0
        moved = set()
        loose = np.argwhere((self.grid == SACK) | (self.grid == LOAF))
        for row, column in loose[::-1].tolist():
            cell, below = (column, row), (column, row + 1)
            was_falling = cell in self.falling
            if self._open(below) and (below != self.baker or was_falling):
                reward += self._drop(cell, below, moved)
            elif self.at(below) in ROUND and below != self.baker:
                for side in (-1, 1):
                    beside, under = (column + side, row), (column + side, row + 1)
                    if self._open(beside) and self._open(under) and self.baker not in (beside, under):
                        reward += self._drop(cell, beside, moved)
                        break
        self.falling = moved
        return reward

    def _drop(self, cell, target, moved):
        kind = self.at(cell)
        self._set(cell, EMPTY)
        crushed = [mouse for mouse in self.mice if mouse["at"] == target]
        self.mice = [mouse for mouse in self.mice if mouse["at"] != target]
        reward = 0.5 * len(crushed)
        if target == self.baker:
            reward += self._suffer()
            return reward
        self._set(target, kind)
        moved.add(target)
        return reward

    def _run_mice(self):
        for mouse in self.mice:
            for turn in (0, 1, 2, 3):
                way = (mouse["way"] - 1 + turn) % 4 + 1
                dx, dy = WAYS[way]
                cell = (mouse["at"][0] + dx, mouse["at"][1] + dy)
                if self._open(cell):
                    mouse["at"] = cell
                    mouse["way"] = int(self.np_random.integers(1, 5)) if self.np_random.random() < 0.2 else way
                    break

    def _meet_mice(self):
        reward = 0.0
        for mouse in self.mice:
            if mouse["at"] == self.baker and not self.safe:
                reward += self._suffer()
            gap = abs(mouse["at"][0] - OVEN_AT[0]) + abs(mouse["at"][1] - OVEN_AT[1])
            if gap == 1:
                self.stack = 0
        return reward

    def _creep(self):
        if self.steps % DARK_PACE == 0:
            self.dark += 1
        if self.baker[0] * CELL >= self.dark:
            return 0.0
        self.dark = max(0, self.dark - DARK_BACK)
        return self._suffer()

    def _suffer(self):
        if self.safe:
            return 0.0
        self.lives -= 1
        self.safe = 12
        return -1.0

    def _shut_off(self):
        doors = ((OVEN_AT[0] - 1, OVEN_AT[1]), (OVEN_AT[0], OVEN_AT[1] - 1))
        return all(self.at(door) == SACK and door not in self.falling for door in doors)

    def _info(self):
        return {"is_success": self.won, "gathered": self.gathered, "lives": self.lives}

    # ---- picture

    def render(self):
        return self._paint()

    def _paint(self):
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        image[TOP:] = TILES[self.grid].transpose(0, 2, 1, 3, 4).reshape(ROWS * CELL, COLS * CELL, 3)
        left, top = OVEN_AT[0] * CELL, TOP + OVEN_AT[1] * CELL
        image[top + 3 : top + 6, left + 1 : left + 6] = EMBER if self.gathered >= GOAL else APRON
        for level in range(self.stack):
            image[top - 2 - 2 * level : top - 2 * level - 1, left + 2 : left + 6] = FLOUR
        for mouse in self.mice:
            x, y = mouse["at"][0] * CELL, TOP + mouse["at"][1] * CELL
            image[y + 3 : y + 6, x + 1 : x + 6] = MOUSE
            image[y + 2, x + 1 : x + 6 : 4] = MOUSE_EAR
        self._paint_baker(image)
        if self.dark:
            image[TOP:, : self.dark] = NIGHT
            image[TOP::3, self.dark - 1] = EMBER
        image[:TOP] = TILE_DARK
        for life in range(self.lives):
            image[2:5, 2 + 5 * life : 5 + 5 * life] = HAT
        for loaf in range(GOAL):
            image[2:5, 28 + 6 * loaf : 32 + 6 * loaf] = CRUST if loaf < self.gathered else NIGHT
        return image

    def _paint_baker(self, image):
        if self.safe % 4 >= 2:
            return
        x, y = self.baker[0] * CELL, TOP + self.baker[1] * CELL
        image[y : y + 2, x + 2 : x + 5] = HAT
        image[y + 2 : y + 4, x + 2 : x + 5] = (240, 196, 160)
        image[y + 4 : y + 7, x + 1 : x + 6] = APRON
        dx, dy = WAYS[self.facing]
        image[y + 3 + 2 * (dy > 0), x + 3 + 2 * dx] = NIGHT
        if self.carrying:
            image[y + 4 : y + 6, x + 2 : x + 5] = FLOUR
