"""Code of the generated mazes: how a maze is built, and what walking into a cell does."""

from __future__ import annotations

BUILD = '''
def _build(self) -> None:
    """Lay out a maze: the doors lie on the way to the exit, and each key lies before its door."""
    rooms, gates = self._carve()
    self.doors: dict[tuple[int, int], int] = {}
    self.start = self.player = rooms[(0, WIDTH - 1, -WIDTH, -1)[int(self.np_random.integers(4))]]
    away = self._distances(self.start)
    way = [max(rooms, key=away.__getitem__)]
    while way[-1] != self.start:
        y, x = way[-1]
        way.append(next((y + j, x + i) for j, i in DIRECTIONS if away.get((y + j, x + i)) == away[y, x] - 1))
    self.exit = way[0]
    locked = [cell for cell in reversed(way) if cell in gates]
    doors = [locked[len(locked) * (number + 1) // (KEYS + 1)] for number in range(KEYS)]
    free = [cell for cell in rooms if cell not in (self.start, self.exit)]
    self.keys: dict[tuple[int, int], int] = {}
    zone: dict[tuple[int, int], int] = {}
    for number in range(KEYS):
        self.doors = {door: 0 for door in doors[number:]}
        zone |= {cell: number for cell in self._distances(self.start) if cell not in zone}
        fresh = [cell for cell in free if zone.get(cell) == number]
        self.keys[fresh[int(self.np_random.integers(len(fresh)))]] = <<kind>>
    free = [cell for cell in free if cell not in self.keys]
    <<gems>>
    # The energy is enough for one way past all things, with some slack.
    self.doors = {}
    stops = [self.start, <<stops>>]
    length = sum(self._distances(one)[other] for one, other in zip(stops, stops[1:], strict=False))
    self.full = self.energy = max(LEAST, min(MOST, int(SLACK * length)))
    self.doors = {door: <<kind>> for <<numbered>>}
    <<built>>
'''

CARVE = '''
def _carve(self) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Connect all rooms without loops; return the middles of the rooms and the gates between them."""
    self.walls = [[y % (2 * STEP) == 0 or x % (2 * STEP) == 0 for x in range(COLUMNS)] for y in range(ROWS)]
    rooms = [(y, x) for y in range(STEP, ROWS, 2 * STEP) for x in range(STEP, COLUMNS, 2 * STEP)]
    waiting, left, gates = rooms[:1], set(rooms[1:]), []
    while waiting:
        place = <<grow>>
        y, x = waiting[place]
        near = [(STEP * j, STEP * i) for j, i in DIRECTIONS if (y + 2 * STEP * j, x + 2 * STEP * i) in left]
        if not near:
            waiting.pop(place)
            continue
        down, right = near[int(self.np_random.integers(len(near)))]
        gates.append((y + down, x + right))
        self.walls[y + down][x + right] = False
        waiting.append((y + 2 * down, x + 2 * right))
        left.remove(waiting[-1])
    return rooms, gates
'''

DISTANCES = '''
def _distances(self, start: tuple[int, int]) -> dict[tuple[int, int], int]:
    """The distances of all cells that can be reached without passing a door."""
    found, waiting = {start: 0}, [start]
    for y, x in waiting:
        for down, right in DIRECTIONS:
            cell = (y + down, x + right)
            if not self.walls[cell[0]][cell[1]] and cell not in self.doors and cell not in found:
                found[cell] = found[y, x] + 1
                waiting.append(cell)
    return found
'''

LOOPS = """
# Open more gates, but none past a door.
for y, x in rooms:
    for j, i in ((STEP, 0), (0, STEP)):
        room = (y + 2 * j, x + 2 * i)
        alike = room in rooms and zone.get((y, x), KEYS) == zone.get(room, KEYS)
        if alike and self.walls[y + j][x + i] and self.np_random.random() < 0.15:
            gates.append((y + j, x + i))
            self.walls[y + j][x + i] = False
"""

PITS = """
# A dead end has one gate.
self.pits = [(y, x) for y, x in free if sum(abs(y - j) + abs(x - i) == STEP for j, i in gates) == 1]
"""

ENTER = '''
def _enter(self, y: int, x: int, first: int) -> bool:
    """Go to a cell if it is open, take what lies there, and return whether the walker is there."""
    if self.walls[y][x]:
        return False
    if (y, x) in self.doors:
        kind = self.doors[y, x]
        if <<open>>:
            return False
        self.held.remove(kind)
        del self.doors[y, x]
        self.reward += FOUND
    self.player = (y, x)
    if (y, x) in self.keys:
        self.held.append(self.keys.pop((y, x)))
        self.reward += FOUND
    <<picked>>
    <<entered>>
    return True
'''

DRAW = (
    '''
def _backdrop(self) -> NDArray[np.uint8]:
    """What no step changes."""
    picture = np.full((SIZE, SIZE, 3), PAGE)
    for y, row in enumerate(self.walls):
        for x, wall in enumerate(row):
            self._put(picture, y, x, WALL_TILE if wall else GROUND)
    <<pits>>
    return picture
''',
    '''
def _put(self, picture: NDArray[np.uint8], y: int, x: int, pixels: NDArray[np.uint8], size: int = CELL) -> None:
    """Draw a thing into a cell; a smaller one in its middle."""
    top, left = TOP + CELL * y + (CELL - size) // 2, LEFT + CELL * x + (CELL - size) // 2
    picture[top : top + size, left : left + size] = pixels
''',
)
