"""Worlds: where places are, which are free, and how a step leads from one to the next.

Each world defines ``_shift`` (the place one step away, or the same place if the way is blocked), ``_spots`` (free
places that can be reached), ``near`` (whether two places touch), ``_pixel`` and ``_paint``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

from envcraft_composer.mechanic import Constants, Mechanic, scaled, traits

_SHIFT = '''
    def _shift(self, place: tuple[int, int], move: int) -> tuple[int, int]:
        """The cell one step away, or the same cell in front of a wall."""
        after = (place[0] + MOVES[move][0], place[1] + MOVES[move][1])
        return place if after in self.walls else after
'''
_SHIFT_WRAP = '''
    def _shift(self, place: tuple[int, int], move: int) -> tuple[int, int]:
        """The cell one step away, across the edges too, or the same cell in front of a wall."""
        after = ((place[0] + MOVES[move][0]) % ROWS, (place[1] + MOVES[move][1]) % COLUMNS)
        return place if after in self.walls else after
'''
_CELLS = '''
    def _reachable(self) -> list[tuple[int, int]]:
        """The cells that can be reached from the avatar's, the nearest first."""
        found, known = [self.at], {self.at}
        for place in found:
            for move in range(1, 5):
                after = self._shift(place, move)
                if after not in known:
                    known.add(after)
                    found.append(after)
        return found
'''
_SPOTS = '''
    def _spots(self, count: int) -> list[tuple[int, int]]:
        """Distinct cells that can be reached, away from the avatar."""
        free = [place for place in self._reachable()[GAP:] if place not in self.taken]
        found = [free[number] for number in self.np_random.permutation(len(free))[:count]]
        self.taken.update(found)
        return found
'''
_NEAR = """
    def near(self, one: tuple[int, int], two: tuple[int, int]) -> bool:
        return one == two
"""
_PIXEL = """
    def _pixel(self, place: tuple[int, int]) -> tuple[int, int]:
        return TOP + CELL * place[0], LEFT + CELL * place[1]
"""
_PAINT = '''
    def _paint(self) -> None:
        """Draw what stays: the floor and the walls."""
        self.picture = picture = np.full((SIZE, SIZE, 3), PALETTE[7])
        picture[5:80] = PALETTE[8]
        floor = picture[TOP : TOP + CELL * ROWS, LEFT : LEFT + CELL * COLUMNS]
        floor[:] = PALETTE[0]
        <<texture>>
        for y, x in self.walls:
            if 0 <= y < ROWS and 0 <= x < COLUMNS:
                top, left = self._pixel((y, x))
                <<wall>>
'''
EDGE = """
self.walls = {(y, x) for y in range(-1, ROWS + 1) for x in range(-1, COLUMNS + 1)}
self.walls -= {(y, x) for y in range(ROWS) for x in range(COLUMNS)}
"""
#: A start from which most of the world can be reached.
_START = """
free = [(y, x) for y in range(ROWS) for x in range(COLUMNS) if (y, x) not in self.walls]
for _ in range(50):
    self.at = free[self.np_random.integers(len(free))]
    if 2 * len(self._reachable()) > len(free):
        break
self.taken = {self.at}
"""
_FIELD = """
for y, x in np.argwhere(self.np_random.random((ROWS, COLUMNS)) < DENSITY).tolist():
    self.walls.add((y, x))
"""
_CAVE = """
# A mole digs at random, so that all of the cave hangs together.
y, x = ROWS // 2, COLUMNS // 2
dug = {(y, x)}
while len(dug) < HOLLOW * ROWS * COLUMNS:
    dy, dx = MOVES[self.np_random.integers(1, 5)]
    y, x = min(max(y + dy, 0), ROWS - 1), min(max(x + dx, 0), COLUMNS - 1)
    dug.add((y, x))
self.walls |= {(y, x) for y in range(ROWS) for x in range(COLUMNS)} - dug
"""
_MAZE = """
self.walls |= {(y, x) for y in range(ROWS) for x in range(COLUMNS) if y % 2 or x % 2}
way = [(2 * int(self.np_random.integers(ROWS // 2)), 2 * int(self.np_random.integers(COLUMNS // 2)))]
carved = {way[0]}
while way:
    y, x = way[-1]
    after = [(y + 2 * dy, x + 2 * dx) for dy, dx in MOVES[1:]]
    after = [(v, u) for v, u in after if 0 <= v < ROWS and 0 <= u < COLUMNS and (v, u) not in carved]
    if not after:
        way.pop()
        continue
    v, u = after[self.np_random.integers(len(after))]
    self.walls -= {((y + v) // 2, (x + u) // 2)}
    carved.add((v, u))
    way.append((v, u))
for y, x in self.np_random.integers((ROWS, COLUMNS), size=(LOOPS, 2)).tolist():
    if y % 2 != x % 2:
        self.walls.discard((y, x))
"""
_ROOMS = """
self.walls |= {(y, x) for y in range(ROWS) for x in range(COLUMNS) if ROOM - 1 in (y % ROOM, x % ROOM)}
for y in range(0, ROWS, ROOM):
    for x in range(0, COLUMNS, ROOM):
        a, b = self.np_random.integers(ROOM - 1, size=2).tolist()
        if y + ROOM < ROWS:
            self.walls.discard((y + ROOM - 1, x + a))
        if x + ROOM < COLUMNS:
            self.walls.discard((y + b, x + ROOM - 1))
"""
_RINGS = """
depth = [[min(y, x, ROWS - 1 - y, COLUMNS - 1 - x) for x in range(COLUMNS)] for y in range(ROWS)]
for ring in range(1, min(ROWS, COLUMNS) // 2, 2):
    cells = [(y, x) for y in range(ROWS) for x in range(COLUMNS) if depth[y][x] == ring]
    low, last = ROWS - 1 - ring, COLUMNS - 1 - ring
    straight = [(y, x) for y, x in cells if y in (ring, low) and ring < x < last]
    straight += [(y, x) for y, x in cells if x in (ring, last) and ring < y < low]
    gates = [straight[number] for number in self.np_random.permutation(len(straight))[:GATES]]
    self.walls |= set(cells) - set(gates)
"""
_LATTICE = """
self.walls |= {(y, x) for y in range(1, ROWS, 2) for x in range(1, COLUMNS, 2)}
for y, x in self.np_random.integers((ROWS, COLUMNS), size=(EXTRA, 2)).tolist():
    self.walls.add((y, x))
"""
_FENCES = """
for y in range(2, ROWS - 1, 3):
    gaps = self.np_random.permutation(COLUMNS)[:GAPS].tolist()
    self.walls |= {(y, x) for x in range(COLUMNS) if x not in gaps}
"""
_HALLS = """
# Four halls, each with a corridor to the next.
self.walls |= {(y, x) for y in range(ROWS) for x in range(COLUMNS)}
corners = np.array(((0, 0), (0, COLUMNS // 2), (ROWS // 2, COLUMNS // 2), (ROWS // 2, 0)))
halls = (corners + self.np_random.integers(min(ROWS, COLUMNS) // 2 - 3, size=(4, 2))).tolist()
for (y, x), (v, u) in zip(halls, halls[1:] + halls[:1]):
    self.walls -= {(y + dy, x + dx) for dy in range(4) for dx in range(4)}
    self.walls -= {(place, x) for place in range(min(y, v), max(y, v) + 1)}
    self.walls -= {(v, place) for place in range(min(x, u), max(x, u) + 1)}
"""
_SLANTS = """
for y, x in np.argwhere(self.np_random.random((ROWS, COLUMNS)) < CLOSED).tolist():
    if (y + LEAN * x) % APART == 0:
        self.walls.add((y, x))
"""
_CROSSES = """
for y, x in self.np_random.integers((ROWS, COLUMNS), size=(CROSSES, 2)).tolist():
    self.walls |= {(y + dy, x + dx) for dy, dx in MOVES}
"""
_TORUS = """
self.walls: set[tuple[int, int]] = set()
for y, x, run in self.np_random.integers((ROWS, COLUMNS, 3), size=(BARS, 3)).tolist():
    self.walls |= {((y + part * (run == 1)) % ROWS, (x + part * (run != 1)) % COLUMNS) for part in range(3)}
"""
_SIDE = """
for y in range(ROWS - 1 - STOREY, 0, -STOREY):
    x = int(self.np_random.integers(-1, 3))
    while x < COLUMNS:
        run = int(self.np_random.integers(2, 5))
        self.walls |= {(y, column) for column in range(max(x, 0), min(x + run, COLUMNS))}
        x += run + int(self.np_random.integers(1, 4))
self.at = (ROWS - 1, int(self.np_random.integers(COLUMNS)))
self.taken = {self.at}
"""
_LANES = """
self.at = (ROWS - 1, int(self.np_random.integers(COLUMNS)))
self.taken = {self.at}
rows = [y for y in range(1, ROWS - 1) if y % BLOCK]
self.cars = []
for y in rows:
    way = 4 if self.np_random.random() < 0.5 else 3
    first, gap = int(self.np_random.integers(COLUMNS)), int(self.np_random.integers(4, 7))
    self.cars += [[(y, (first + x) % COLUMNS), way, 2 + y % 2] for x in range(0, COLUMNS - 2, gap)]
"""
_TRAFFIC = """
for car in self.cars:
    if self.clock % car[2] == 0:
        y, x = car[0]
        car[0] = (y, (x + MOVES[car[1]][1]) % COLUMNS)
if any(self.near(car[0], self.at) for car in self.cars):
    self._harm()
"""
_HIT_CAR = """
if any(self.near(car[0], self.at) for car in self.cars):
    self._harm()
"""
_DRAW_CARS = """
for place, way, _ in self.cars:
    self._blit(frame, place, CAR if way == 4 else CAR[:, ::-1], PALETTE[6])
"""
_PLANE = """
self.at = tuple(self.np_random.uniform((7, 2), (LOW, 82 - CELL)).tolist())
self.taken = [self.at]
"""
_PLANE_SPOTS = '''
    def _spots(self, count: int) -> list[tuple[float, float]]:
        """Points apart from each other and from the avatar."""
        found, apart = [], 2.2 * CELL
        while len(found) < count:
            place = tuple(self.np_random.uniform((7, 2), (LOW, 82 - CELL)).tolist())
            # A crowded plane makes do with less room.
            apart *= 0.98
            if all(max(abs(place[0] - y), abs(place[1] - x)) > apart for y, x in self.taken):
                self.taken.append(place)
                found.append(place)
        return found
'''
_PLANE_SHIFT = '''
    def _shift(self, place: tuple[float, float], move: int, speed: float = SPEED) -> tuple[float, float]:
        """The point one step away; the edges stop it."""
        y, x = place[0] + speed * MOVES[move][0], place[1] + speed * MOVES[move][1]
        return min(max(y, 6.0), 79.0 - CELL), min(max(x, 1.0), 83.0 - CELL)
'''
_SPACE_SHIFT = '''
    def _shift(self, place: tuple[float, float], move: int, speed: float = SPEED) -> tuple[float, float]:
        """The point one step away, across the edges too."""
        return self._wrap(place[0] + speed * MOVES[move][0], place[1] + speed * MOVES[move][1])

    def _wrap(self, y: float, x: float) -> tuple[float, float]:
        return 6 + (y - 6) % (73 - CELL), 1 + (x - 1) % (82 - CELL)
'''
_PLANE_NEAR = """
    def near(self, one: tuple[float, float], two: tuple[float, float]) -> bool:
        return abs(one[0] - two[0]) < REACH and abs(one[1] - two[1]) < REACH
"""
_PLANE_PIXEL = """
    def _pixel(self, place: tuple[float, float]) -> tuple[int, int]:
        return round(place[0]), round(place[1])
"""
_PLANE_PAINT = '''
    def _paint(self) -> None:
        """Draw what stays."""
        self.picture = picture = np.full((SIZE, SIZE, 3), PALETTE[7])
        floor = picture[5:80]
        floor[:] = PALETTE[0]
        <<texture>>
'''


def frame_of(rows: int, columns: int) -> Constants:
    """Where a world of so many cells is drawn."""
    cell = min(74 // rows, 82 // columns)
    return {
        "ROWS": rows,
        "COLUMNS": columns,
        "CELL": cell,
        "TOP": 5 + (75 - cell * rows) // 2,
        "LEFT": (84 - cell * columns) // 2,
        "GAP": min(rows, columns) // 2,
    }


def _drawn(sizes: tuple[int, int], odd: bool = False, **ranges: tuple[float, float]) -> Callable[..., Constants]:
    """Draw the size of a world of cells, and constants from ranges."""

    def draw(rng: Random, level: float) -> Constants:
        # Half of the size is chance, half difficulty.
        rows, columns = (scaled(*sizes, (rng.random() + level) / 2) for _ in range(2))
        if odd:
            rows, columns = rows | 1, columns | 1
        found = frame_of(rows, columns)
        for name, (low, high) in ranges.items():
            found[name] = rng.randint(int(low), int(high)) if isinstance(low, int) else round(rng.uniform(low, high), 2)
        return found

    return draw


def _rooms(rng: Random, level: float) -> Constants:
    room = rng.choice((4, 5))
    most = 14 // room
    return {**frame_of(room * rng.randint(2, most) - 1, room * rng.randint(2, most) - 1), "ROOM": room}


def _slants(rng: Random, level: float) -> Constants:
    found = _drawn((10, 13), APART=(4, 5), CLOSED=(0.5, 0.7))(rng, level)
    return {**found, "LEAN": rng.choice((-1, 1))}


def _plane(rng: Random, level: float) -> Constants:
    cell = rng.randint(6, 8)
    return {"CELL": cell, "SPEED": rng.choice((2.0, 2.5, 3.0)), "REACH": cell - 1, "LOW": 78 - cell}


def _grid(
    name: str, about: str, build: str, draw: Callable[..., Constants], pace: float = 1.0, more: str = ""
) -> Mechanic:
    return Mechanic(
        name,
        about,
        gives=traits("cells", "walk", "walled", *more.split()),
        parts={
            "build": EDGE + build + _START,
            "method:shift": _SHIFT,
            "method:reachable": _CELLS,
            "method:spots": _SPOTS,
            "method:near": _NEAR,
            "method:pixel": _PIXEL,
            "method:paint": _PAINT,
        },
        draw=draw,
        pace=pace,
    )


def _variant(
    base: Mechanic, name: str, about: str, gives: frozenset[str], parts: dict[str, str], **more: Any
) -> Mechanic:
    return replace(base, name=name, about=about, gives=gives, parts={**base.parts, **parts}, **more)


_FIELD_WORLD = _grid(
    "field", "An open field with scattered blocks.", _FIELD, _drawn((9, 13), DENSITY=(0.05, 0.18)), 1.0, "open roomy"
)
_PLANE_WORLD = Mechanic(
    "plane",
    "An open plane with edges, in which everything moves by pixels.",
    gives=traits("plane"),
    parts={
        "build": _PLANE,
        "method:shift": _PLANE_SHIFT,
        "method:spots": _PLANE_SPOTS,
        "method:near": _PLANE_NEAR,
        "method:pixel": _PLANE_PIXEL,
        "method:paint": _PLANE_PAINT,
    },
    draw=_plane,
    pace=1.1,
)
PLATFORMS = _variant(
    _FIELD_WORLD,
    "platforms",
    "Platforms seen from the side. What has no ground under it falls.",
    traits("cells", "side"),
    {"build": EDGE + _SIDE},
    draw=_drawn((11, 13), STOREY=(3, 3)),
    pace=1.6,
)

WORLDS = (
    _FIELD_WORLD,
    _grid("cave", "A cave with rough walls.", _CAVE, _drawn((11, 14), HOLLOW=(0.5, 0.62)), 1.3, "roomy"),
    _grid("maze", "A maze with a few loops.", _MAZE, _drawn((9, 13), odd=True, LOOPS=(6, 14)), 2.2, "narrow"),
    _grid("rooms", "Rooms that are joined by narrow doorways.", _ROOMS, _rooms, 1.5, "roomy"),
    _grid(
        "rings",
        "Rings of walls, one inside the other, each with a few gates.",
        _RINGS,
        _drawn((11, 13), odd=True, GATES=(2, 4)),
        2.0,
        "narrow",
    ),
    _grid("lattice", "A lattice of pillars.", _LATTICE, _drawn((9, 13), odd=True, EXTRA=(2, 8)), 1.1, "roomy"),
    _grid("fences", "Rows of fences, each with a few gaps.", _FENCES, _drawn((11, 13), GAPS=(3, 5)), 1.5, "roomy"),
    _grid("halls", "Four halls in a ring of corridors.", _HALLS, _drawn((11, 13)), 1.5, "roomy"),
    _grid("slants", "Slanted walls with many gaps.", _SLANTS, _slants, 1.3, "open"),
    _grid(
        "crosses", "A field with blocks like crosses.", _CROSSES, _drawn((10, 13), CROSSES=(4, 7)), 1.2, "open roomy"
    ),
    _variant(
        _FIELD_WORLD,
        "torus",
        "A field without edges: who leaves at one side comes in at the other.",
        traits("cells", "walk", "wrap", "open", "roomy"),
        {"build": _TORUS + _START, "method:shift": _SHIFT_WRAP},
        draw=_drawn((9, 13), BARS=(3, 9)),
        pace=0.9,
    ),
    PLATFORMS,
    _variant(
        _FIELD_WORLD,
        "lanes",
        "A road of many lanes. Cars drive along them, leave at one side and come back at the other.",
        traits("cells", "walk", "traffic", "danger"),
        {
            "build": EDGE + _LANES,
            "touch": _HIT_CAR,
            "stir": _TRAFFIC,
            "draw": _DRAW_CARS,
        },
        sprites=("CAR",),
        draw=_drawn((10, 13), BLOCK=(3, 4)),
        pace=1.5,
    ),
    _PLANE_WORLD,
    _variant(
        _PLANE_WORLD,
        "space",
        "A part of space without edges, in which everything moves by pixels.",
        traits("plane", "wrap"),
        {"method:shift": _SPACE_SHIFT},
        pace=1.0,
    ),
)
