"""Dungeon: find the key, unlock the vault and take the treasure before the torch burns out.

Goal: the hero starts in a maze that no two seeds share. A key lies in one dead corner, a locked vault with the
treasure in another. Slimes roam the corridors: touching one costs a heart, and the third lost heart ends the game. The
torch lasts 600 steps: its circle of light shrinks in five stages, which the bar at the top counts.

Controls: a direction turns the hero and walks one cell. The first button strikes the cell in front with the sword. The
second button unlocks the door in front, if the key has been found.

Rewards: +0.05 for each cell entered for the first time, +1 for the key, +1 for the door, +0.3 for a slime struck, -0.5
for a heart lost, +5 for the treasure, -1 more for the last heart.

What there is to learn: two errands in a fixed order, far apart, with a limit on the way, and two buttons that are only
useful in front of the right thing.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

SIZE = 84
CELL = 7
CELLS = 11
TOP, LEFT = 7, 3
MAX_STEPS = 600
HEARTS = 3
SLIMES, SLIME_PERIOD = 2, 4
SHORTCUTS = 6
TORCH_STAGES = 5

Cell = tuple[int, int]
MOVES: dict[int, Cell] = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}

BLACK, FLOOR, CRACK, BRICK, MORTAR, SKIN, TUNIC, STEEL, GOLD, WOOD, IRON, SLIME, GLINT, HEART, FLAME, SLOT = range(16)
# One hexadecimal red-green-blue triple for each name above.
LIT = np.frombuffer(
    bytes.fromhex(
        "141018 605254 54474b 343046 403c54 f6cea6 4c8ad6 e2e8f0 "
        "ffd050 966038 463c42 68c45c d4f8b0 e24658 ff983e 362e3c"
    ),
    dtype=np.uint8,
).reshape(-1, 3)
# Every colour has a twin in the dark, so that light and shadow are one addition to the palette index.
DARK = len(LIT)
PALETTE = np.concatenate([LIT, (LIT * 0.4 + (4, 4, 16)).astype(np.uint8)])
DISTANCE = np.add.outer(np.arange(-SIZE, SIZE) ** 2, np.arange(-SIZE, SIZE) ** 2)


def pixel_art(*rows: str) -> NDArray[np.uint8]:
    """Read rows of hexadecimal palette indices; a dot (index 0) is transparent."""
    return np.array([[int(c, 16) for c in row.replace(".", "0")] for row in rows], dtype=np.uint8)


HERO_ART = pixel_art(".99999.", ".95559.", ".5a5a5.", "..555..", ".66666.", "5666665", "..9.9..")
SLIME_ART = pixel_art(".......", "..bbb..", ".bcbbb.", "bcbbbbb", "bbabbab", "bbbbbbb", ".bbbbb.")
KEY_ART = pixel_art(".......", ".88....", "8..8...", "8..8888", "8..8.88", ".88....", ".......")
DOOR_ART = pixel_art("a99999a", "a9a9a9a", "a9a9a9a", "a999a9a", "a998a9a", "a9a9a9a", "a9a9a9a")
CHEST_ART = pixel_art(".......", ".99999.", "9888889", "aaa8aaa", "9998999", "9999999", "a99999a")
HEART_ART = pixel_art("dd.dd", "ddddd", ".ddd.", "..d..")


def stamp(canvas: NDArray[np.uint8], art: NDArray[np.uint8], x: int, y: int) -> None:
    """Draw pixel art with its top left corner at (x, y)."""
    height, width = art.shape
    np.copyto(canvas[y : y + height, x : x + width], art, where=art > 0)


class Dungeon(gym.Env[NDArray[np.uint8], NDArray[np.int64]]):
    """A maze with a key, a door, a treasure and slimes."""

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        super().reset(seed=seed)
        self.steps = 0
        self.hearts = HEARTS
        self.has_key = self.door_open = self.striking = False
        self.won = self.lost = False
        self._dig_maze()
        self._place_things()
        self.background = self._draw_background()
        return self.render(), self._info()

    def step(self, action: NDArray[np.int64]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        direction, strike, unlock = (int(part) for part in action)
        self.steps += 1
        reward = 0.0 if self.won or self.lost else self._advance(direction, strike, unlock)
        terminated = self.won or self.lost
        truncated = self.steps >= MAX_STEPS and not terminated
        return self.render(), reward, terminated, truncated, self._info()

    def render(self) -> NDArray[np.uint8]:
        return PALETTE.take(self._draw(), axis=0)

    def _info(self) -> dict[str, Any]:
        return {
            "is_success": self.won,
            "score": self.has_key + self.door_open + self.won,
            "hearts": self.hearts,
            "steps": self.steps,
        }

    # -- the maze --------------------------------------------------------------------------------------------------

    def _dig_maze(self) -> None:
        """Rooms lie on odd coordinates; a random depth-first walk digs the corridors between them."""
        self.walls = np.ones((CELLS, CELLS), dtype=bool)
        path = [self._random_room()]
        self.walls[path[0][1], path[0][0]] = False
        while path:
            x, y = path[-1]
            ways = [
                (dx, dy)
                for dx, dy in MOVES.values()
                if 0 < x + 2 * dx < CELLS and 0 < y + 2 * dy < CELLS and self.walls[y + 2 * dy, x + 2 * dx]
            ]
            if not ways:
                path.pop()
                continue
            dx, dy = ways[int(self.np_random.integers(len(ways)))]
            self.walls[y + dy, x + dx] = self.walls[y + 2 * dy, x + 2 * dx] = False
            path.append((x + 2 * dx, y + 2 * dy))

    def _random_room(self) -> Cell:
        x, y = (2 * self.np_random.integers(0, CELLS // 2, size=2) + 1).tolist()
        return x, y

    def _place_things(self) -> None:
        self.hero = self._random_room()
        self.facing = MOVES[2]
        self.visited = {self.hero}
        from_hero = self._distances(self.hero)
        # The room farthest away is a dead end, so the one corridor cell that leads into it is the place for the door.
        self.treasure = max(from_hero, key=lambda cell: from_hero[cell])
        self.door = next(cell for cell in self._neighbours(self.treasure) if cell in from_hero)
        from_treasure = self._distances(self.treasure)
        rooms = [cell for cell in from_hero if cell[0] % 2 and cell[1] % 2]
        self.key = max(rooms, key=lambda cell: min(from_hero[cell], from_treasure[cell]))
        self._open_shortcuts()
        far = [cell for cell in rooms if from_hero[cell] > 6 and cell not in (self.key, self.treasure)]
        self.slimes = [far[i] for i in self.np_random.choice(len(far), SLIMES, replace=False).tolist()]
        self.slime_moves = [MOVES[int(self.np_random.integers(1, 5))] for _ in self.slimes]

    def _open_shortcuts(self) -> None:
        """Loops let the hero walk around a slime; none of them may open a second way into the vault."""
        vault = {self.treasure, *self._neighbours(self.treasure)}
        for _ in range(SHORTCUTS):
            x, y = self._random_room()
            dx, dy = MOVES[int(self.np_random.integers(1, 5))]
            cell = (x + dx, y + dy)
            if cell not in vault and 0 < cell[0] < CELLS - 1 and 0 < cell[1] < CELLS - 1:
                self.walls[cell[1], cell[0]] = False

    def _neighbours(self, cell: Cell) -> list[Cell]:
        return [(cell[0] + dx, cell[1] + dy) for dx, dy in MOVES.values()]

    def _distances(self, origin: Cell) -> dict[Cell, int]:
        found = {origin: 0}
        queue = deque([origin])
        while queue:
            cell = queue.popleft()
            for x, y in self._neighbours(cell):
                if (x, y) not in found and not self.walls[y, x]:
                    found[x, y] = found[cell] + 1
                    queue.append((x, y))
        return found

    # -- the rules -------------------------------------------------------------------------------------------------

    def _advance(self, direction: int, strike: int, unlock: int) -> float:
        if direction in MOVES:
            self._walk(MOVES[direction])
        reward = self._unlock() if unlock else 0.0
        reward += self._strike(bool(strike)) + self._suffer()
        self._move_slimes()
        reward += self._explore() + self._collect() + self._suffer()
        self.lost = self.hearts == 0
        return reward - 1.0 if self.lost else reward

    def _blocked(self, cell: Cell) -> bool:
        return bool(self.walls[cell[1], cell[0]]) or (cell == self.door and not self.door_open)

    def _front(self) -> Cell:
        return self.hero[0] + self.facing[0], self.hero[1] + self.facing[1]

    def _walk(self, move: Cell) -> None:
        self.facing = move
        if not self._blocked(self._front()):
            self.hero = self._front()

    def _unlock(self) -> float:
        if self.has_key and not self.door_open and self._front() == self.door:
            self.door_open = True
            return 1.0
        return 0.0

    def _strike(self, strike: bool) -> float:
        self.striking = strike
        return 0.3 * self._remove_slimes(self._front()) if strike else 0.0

    def _remove_slimes(self, cell: Cell) -> int:
        kept = [i for i, slime in enumerate(self.slimes) if slime != cell]
        removed = len(self.slimes) - len(kept)
        self.slimes = [self.slimes[i] for i in kept]
        self.slime_moves = [self.slime_moves[i] for i in kept]
        return removed

    def _move_slimes(self) -> None:
        if self.steps % SLIME_PERIOD:
            return
        for i, (x, y) in enumerate(self.slimes):
            dx, dy = self.slime_moves[i]
            if self._blocked((x + dx, y + dy)):
                self.slime_moves[i] = MOVES[int(self.np_random.integers(1, 5))]
            else:
                self.slimes[i] = (x + dx, y + dy)

    def _collect(self) -> float:
        if self.hero == self.key and not self.has_key:
            self.has_key = True
            return 1.0
        if self.hero == self.treasure:
            self.won = True
            return 5.0
        return 0.0

    def _suffer(self) -> float:
        touched = min(self._remove_slimes(self.hero), self.hearts)
        self.hearts -= touched
        return -0.5 * touched

    def _explore(self) -> float:
        if self.hero in self.visited:
            return 0.0
        self.visited.add(self.hero)
        return 0.05

    # -- the picture -----------------------------------------------------------------------------------------------

    def _at(self, cell: Cell) -> Cell:
        return LEFT + cell[0] * CELL, TOP + cell[1] * CELL

    def _draw_background(self) -> NDArray[np.uint8]:
        canvas = np.full((SIZE, SIZE), BLACK, dtype=np.uint8)
        area = canvas[TOP:, LEFT : LEFT + CELLS * CELL]
        area[:] = np.kron(self.walls, np.ones((CELL, CELL), dtype=np.uint8)) * BRICK
        rows, columns = np.indices(area.shape)
        mortar = (rows % 3 == 2) | ((columns + 3 * (rows // 3 % 2)) % 6 == 5)
        area[(area == BRICK) & mortar] = MORTAR
        floor = area == 0
        area[floor] = np.where(self.np_random.random(area.shape) < 0.12, CRACK, FLOOR)[floor]
        return canvas

    def _draw(self) -> NDArray[np.uint8]:
        canvas = self.background.copy()
        if not self.door_open:
            stamp(canvas, DOOR_ART, *self._at(self.door))
        if not self.has_key:
            stamp(canvas, KEY_ART, *self._at(self.key))
        stamp(canvas, CHEST_ART, *self._at(self.treasure))
        for slime in self.slimes:
            stamp(canvas, SLIME_ART, *self._at(slime))
        x, y = self._at(self.hero)
        stamp(canvas, HERO_ART, x, y)
        self._draw_sword(canvas, x, y)
        torch = math.ceil(TORCH_STAGES * (1 - self.steps / MAX_STEPS))
        radius = 12 + 6 * torch
        canvas[DISTANCE[SIZE - y - CELL // 2 :, SIZE - x - CELL // 2 :][:SIZE, :SIZE] > radius**2] += DARK
        self._draw_hud(canvas, torch)
        return canvas

    def _draw_sword(self, canvas: NDArray[np.uint8], x: int, y: int) -> None:
        (dx, dy), reach = self.facing, 9 if self.striking else 5
        left, right = sorted((x + 3 + 3 * dx, x + 3 + reach * dx))
        top, bottom = sorted((y + 3 + 3 * dy, y + 3 + reach * dy))
        canvas[top : bottom + 1, left : right + 1] = STEEL

    def _draw_hud(self, canvas: NDArray[np.uint8], torch: int) -> None:
        canvas[:TOP] = BLACK
        for i in range(HEARTS):
            art = HEART_ART if i < self.hearts else np.where(HEART_ART > 0, np.uint8(SLOT), HEART_ART)
            stamp(canvas, art, 3 + 7 * i, 2)
        if self.has_key:
            stamp(canvas, KEY_ART, 27, 0)
        for i in range(TORCH_STAGES):
            canvas[2:5, 41 + 8 * i : 48 + 8 * i] = FLAME if i < torch else SLOT
