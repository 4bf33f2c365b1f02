"""Toy Room: a tin soldier trades places through windows to gather a marble in each of three rooms.

Walls with windows cut the carpet into three rooms. Nobody can walk through a window, but button one makes the soldier
and the nearest thing in the direction it faces, an alphabet cube or a wind-up beetle, trade places, up to six cells
away. In each room a conveyor belt carries marbles between a tray and a grinder and turns round every 140 steps.
Beetles wipe paint off, fire spreads with the wind, and the soldier's water puts it out cell by cell.
"""

import gymnasium as gym
import numpy as np
from gymnasium import spaces

SIZE = 84
CELL = 6
WIDTH, HEIGHT = 14, 13
TOP = 6
LIMIT = 950
LIVES = 2

ROOM_OF_COLUMN = (0, 0, 0, 0, None, 1, 1, 1, 1, None, 2, 2, 2, 2)
WALL_COLUMNS = (4, 9)
WINDOW_ROWS = (2, 4, 6, 8, 10)
BELT_COLUMNS = (1, 7, 12)
ROOM_CENTRES = ((2, 6), (6, 6), (11, 6))
TOY_BOX = (0, 12)

BEETLES = 2
BEETLE_PACE = 5
MOST_WIPED = 40
TRADE_REACH = 36 // CELL
TRADE_COOLDOWN = 10

BELT_PACE = 3 * CELL
BELT_TURN = 140
MARBLE_GAP = 25

FIRES = 3
FIRE_SPREAD = 8
FIRE_LASTS = 90
WATER = 12

CARPET = (40, 120, 120)
CARPET_WEAVE = (34, 106, 108)
PAINT = (250, 206, 70)
WALL = (184, 58, 44)
WALL_STUD = (220, 92, 74)
GLASS = (150, 210, 230)
BELT = (74, 74, 82)
ARROW = (150, 150, 160)
GRINDER = (40, 10, 10)
TRAY = (120, 190, 120)
TIN = (206, 212, 220)
TIN_RED = (220, 50, 50)
BEETLE = (50, 40, 90)
CUBE = (240, 150, 60)
CUBE_FACE = (255, 240, 200)
MARBLE = (255, 255, 255)
FLAME = (255, 110, 30)
FLAME_TIP = (255, 220, 90)
WATER_BLUE = (80, 140, 255)
BOX = (150, 90, 50)

DIRECTIONS = {1: (0, -1), 2: (0, 1), 3: (-1, 0), 4: (1, 0)}


class GameEnv(gym.Env):
    """Three rooms, three marbles, no doors."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
        self.action_space = spaces.MultiDiscrete([5, 2, 2])
        self.wall = np.zeros((HEIGHT, WIDTH), dtype=bool)
        self.wall[:, WALL_COLUMNS] = True
        self.floor = self._lay_carpet()

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.lives = LIVES
        self.safe = 0
        self.soldier = (2, 6)
        self.facing = 4
        self.painted = np.zeros((HEIGHT, WIDTH), dtype=bool)
        self.wiped = 0
        self.cooldown = 0
        self.water = WATER
        self.belt_way = 1
        self.marbles = []
        self.gathered = [False, False, False]
        self.visited = {0}
        self.wind = int(self.np_random.integers(1, 5))
        self.fire = np.zeros((HEIGHT, WIDTH), dtype=np.int64)
        self._place_cubes()
        self._place_beetles()
        for _ in range(FIRES):
            self._ignite_somewhere()
        self._frame = self._draw()
        return self._frame.copy(), self._info()

    def _place_cubes(self):
        """One cube in the first room and two in each other, all of them in rows with windows."""
        self.cubes = []
        for room in (0, 1, 1, 2, 2):
            while True:
                columns = [c for c in range(WIDTH) if ROOM_OF_COLUMN[c] == room and c != BELT_COLUMNS[room]]
                column = columns[int(self.np_random.integers(len(columns)))]
                row = WINDOW_ROWS[int(self.np_random.integers(len(WINDOW_ROWS)))]
                if (column, row) not in self.cubes and (column, row) != self.soldier:
                    self.cubes.append((column, row))
                    break

    def _place_beetles(self):
        self.beetles = []
        for room in (1, 2):
            column, _ = ROOM_CENTRES[room]
            self.beetles.append([(column, int(self.np_random.choice((3, 9)))), int(self.np_random.integers(1, 5))])

    def _ignite_somewhere(self):
        for _ in range(50):
            cell = (int(self.np_random.integers(WIDTH)), int(self.np_random.integers(HEIGHT)))
            near = abs(cell[0] - self.soldier[0]) + abs(cell[1] - self.soldier[1]) < 4
            if self._burnable(cell) and not near:
                self.fire[cell[1], cell[0]] = FIRE_LASTS
                return

    # ---- geometry

    @staticmethod
    def inside(cell):
        return 0 <= cell[0] < WIDTH and 0 <= cell[1] < HEIGHT

    def free(self, cell):
        return self.inside(cell) and not self.wall[cell[1], cell[0]] and cell not in self.cubes

    def _burnable(self, cell):
        on_belt = cell[0] in BELT_COLUMNS
        return self.free(cell) and not self.fire[cell[1], cell[0]] and not on_belt and cell != TOY_BOX

    def sees_through(self, cell):
        """Walls end a line of sight except in the rows of the windows."""
        return not self.wall[cell[1], cell[0]] or cell[1] in WINDOW_ROWS

    def grinder(self, room):
        return BELT_COLUMNS[room], HEIGHT - 1

    # ---- rules

    def step(self, action):
        move, trade = int(action[0]), bool(action[1])
        reward = 0.0
        if not self._over():
            self.steps += 1
            self.safe = max(0, self.safe - 1)
            self.cooldown = max(0, self.cooldown - 1)
            if move:
                self.facing = move
                reward += self._walk(DIRECTIONS[move])
            if trade and not self.cooldown:
                self._trade()
            self._run_belts()
            self._run_beetles()
            self._spread_fire()
            reward += self._gather() + self._suffer()
            self.visited.add(ROOM_OF_COLUMN[self.soldier[0]])
            if self._over():
                reward += 5.0 if all(self.gathered) else -1.0
        terminated = self._over()
        truncated = self.steps >= LIMIT and not terminated
        self._frame = self._draw()
        return self._frame.copy(), float(reward), terminated, truncated, self._info()

    def _over(self):
        return all(self.gathered) or self.lives <= 0 or self.wiped >= MOST_WIPED

    def _walk(self, way):
        target = (self.soldier[0] + way[0], self.soldier[1] + way[1])
        if not self.free(target):
            return 0.0
        self._shove(target, way)
        self.soldier = target
        if not self.painted[target[1], target[0]]:
            self.painted[target[1], target[0]] = True
            return 0.02
        return 0.0

    def _shove(self, target, way):
        """A marble in a room that has given its marble already is pushed ahead of the soldier."""
        room = ROOM_OF_COLUMN[target[0]]
        beyond = (target[0] + way[0], target[1] + way[1])
        if target in self.marbles and self.gathered[room] and self.free(beyond):
            self.marbles[self.marbles.index(target)] = beyond

    def _trade(self):
        """Change places with the first cube or beetle in the line of sight."""
        dx, dy = DIRECTIONS[self.facing]
        for distance in range(1, TRADE_REACH + 1):
            cell = (self.soldier[0] + distance * dx, self.soldier[1] + distance * dy)
            if not self.inside(cell) or not self.sees_through(cell):
                return
            if cell in self.cubes:
                self.cubes[self.cubes.index(cell)] = self.soldier
            elif any(beetle[0] == cell for beetle in self.beetles):
                next(beetle for beetle in self.beetles if beetle[0] == cell)[0] = self.soldier
            else:
                continue
            self.soldier = cell
            self.cooldown = TRADE_COOLDOWN
            self.safe = max(self.safe, 3)
            return

    def _run_belts(self):
        if self.steps % BELT_TURN == 0:
            self.belt_way = -self.belt_way
        if self.steps % MARBLE_GAP == 0:
            room = self.steps // MARBLE_GAP % 3
            self.marbles.append((BELT_COLUMNS[room], 5 + int(self.np_random.integers(0, 3))))
        if self.steps % BELT_PACE:
            return
        carried = [self._carry(cell) for cell in self.marbles]
        self.marbles = [cell for cell in carried if cell[1] != HEIGHT - 1 or cell[0] not in BELT_COLUMNS]
        self.soldier = self._carry(self.soldier)
        for beetle in self.beetles:
            beetle[0] = self._carry(beetle[0])

    def _carry(self, cell):
        """Along the belt, but not over its ends and not into a cube."""
        column, row = cell
        if column not in BELT_COLUMNS:
            return cell
        ahead = (column, min(max(row + self.belt_way, 0), HEIGHT - 1))
        return cell if ahead in self.cubes else ahead

    def _run_beetles(self):
        if self.steps % BEETLE_PACE:
            return
        for beetle in self.beetles:
            if self.np_random.random() < 0.3:
                beetle[1] = int(self.np_random.integers(1, 5))
            dx, dy = DIRECTIONS[beetle[1]]
            cell = (beetle[0][0] + dx, beetle[0][1] + dy)
            if self.free(cell) and cell[1] != HEIGHT - 1:
                beetle[0] = cell
            else:
                beetle[1] = int(self.np_random.integers(1, 5))
            column, row = beetle[0]
            if self.painted[row, column]:
                self.painted[row, column] = False
                self.wiped += 1

    def _spread_fire(self):
        burning = self.fire > 0
        self.fire[burning] -= 1
        if self.steps % FIRE_SPREAD:
            return
        cells = np.argwhere(self.fire > 0)
        if not len(cells):
            self._ignite_somewhere()
            return
        row, column = cells[int(self.np_random.integers(len(cells)))].tolist()
        ways = [self.wind] if self.np_random.random() < 0.5 else [1, 2, 3, 4]
        dx, dy = DIRECTIONS[ways[int(self.np_random.integers(len(ways)))]]
        cell = (column + dx, row + dy)
        if self._burnable(cell):
            self.fire[cell[1], cell[0]] = FIRE_LASTS

    def _gather(self):
        room = ROOM_OF_COLUMN[self.soldier[0]]
        if self.soldier not in self.marbles or self.gathered[room]:
            return 0.0
        self.marbles.remove(self.soldier)
        self.gathered[room] = True
        return 2.0

    def _suffer(self):
        column, row = self.soldier
        if self.soldier == TOY_BOX:
            self.water = WATER
        hurt = any(beetle[0] == self.soldier for beetle in self.beetles)
        if self.fire[row, column]:
            self.fire[row, column] = 0
            if self.water:
                self.water -= 1
            else:
                hurt = True
        ground = self.soldier in map(self.grinder, range(3))
        if not (hurt or ground) or self.safe:
            return 0.0
        if ground:
            self.soldier = next(c for c in self._room_cells(ROOM_OF_COLUMN[column]) if self.free(c))
        self.lives -= 1
        self.safe = 12
        return -1.0

    @staticmethod
    def _room_cells(room):
        centre = ROOM_CENTRES[room]
        cells = [(c, r) for c in range(WIDTH) for r in range(HEIGHT) if ROOM_OF_COLUMN[c] == room]
        return sorted(cells, key=lambda cell: abs(cell[0] - centre[0]) + abs(cell[1] - centre[1]))

    def _info(self):
        return {
            "is_success": all(self.gathered),
            "marbles": sum(self.gathered),
            "lives": self.lives,
            "wiped": self.wiped,
        }

    # ---- picture

    def render(self):
        return self._frame.copy()

    def _lay_carpet(self):
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        image[:] = CARPET
        image[::2, 1::2] = CARPET_WEAVE
        for column in WALL_COLUMNS:
            left = column * CELL
            image[TOP:, left : left + CELL] = WALL
            image[TOP + 1 :: 3, left + 1 : left + 5 : 3] = WALL_STUD
            for row in WINDOW_ROWS:
                image[TOP + row * CELL + 1 : TOP + row * CELL + 5, left : left + CELL] = GLASS
        for column in BELT_COLUMNS:
            left = column * CELL
            image[TOP:, left : left + CELL] = BELT
            image[TOP : TOP + 3, left : left + CELL] = TRAY
            image[SIZE - CELL :, left : left + CELL] = GRINDER
            image[SIZE - CELL : SIZE : 2, left : left + CELL : 2] = TIN_RED
        image[SIZE - CELL :, :CELL] = BOX
        image[SIZE - 4 : SIZE - 1, 1:5] = WATER_BLUE
        image[:TOP] = (16, 30, 30)
        return image

    @staticmethod
    def _fill(image, cell, colour, inset=0):
        left, top = cell[0] * CELL, TOP + cell[1] * CELL
        image[top + inset : top + CELL - inset, left + inset : left + CELL - inset] = colour

    def _draw(self):
        image = self.floor.copy()
        for row, column in np.argwhere(self.painted).tolist():
            self._fill(image, (column, row), PAINT, inset=1)
        shift = (self.steps * self.belt_way // 3) % CELL
        for column in BELT_COLUMNS:
            image[TOP + 3 + shift : SIZE - CELL : CELL, column * CELL + 2 : column * CELL + 4] = ARROW
        for row, column in np.argwhere(self.fire).tolist():
            self._fill(image, (column, row), FLAME, inset=1)
            image[TOP + row * CELL + 1 + self.steps % 2, column * CELL + 2 : column * CELL + 4] = FLAME_TIP
        for cell in self.cubes:
            self._fill(image, cell, CUBE)
            self._fill(image, cell, CUBE_FACE, inset=2)
        for cell in self.marbles:
            self._fill(image, cell, MARBLE, inset=2)
        for cell, _ in self.beetles:
            self._fill(image, cell, BEETLE, inset=1)
            image[TOP + cell[1] * CELL + 2, cell[0] * CELL + 1 : cell[0] * CELL + 5 : 3] = FLAME_TIP
        self._draw_soldier(image)
        self._draw_counts(image)
        return image

    def _draw_soldier(self, image):
        if self.safe % 4 >= 2:
            return
        left, top = self.soldier[0] * CELL, TOP + self.soldier[1] * CELL
        image[top : top + 6, left + 1 : left + 5] = TIN
        image[top + 2 : top + 4, left + 1 : left + 5] = TIN_RED
        dx, dy = DIRECTIONS[self.facing]
        image[top + 2 + 2 * dy, left + 2 + 2 * dx] = BEETLE

    def _draw_counts(self, image):
        for life in range(self.lives):
            image[1:4, 2 + 4 * life : 5 + 4 * life] = TIN
        for room, gathered in enumerate(self.gathered):
            image[1:4, 14 + 5 * room : 17 + 5 * room] = MARBLE if gathered else BELT
        image[1:3, 32 : 32 + 2 * self.water] = WATER_BLUE
        image[3:5, 32 : 32 + self.wiped] = BEETLE
        image[1:4, 76:82] = ARROW if self.cooldown else CUBE
