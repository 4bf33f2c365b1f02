"""The family `snake`: a snake that grows as it eats."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import ClassVar, Self

from envcraft.environments.source_builder import SourceBuilder
from envcraft_families.look import Look
from envcraft_families.variant import Variant, between

SIZES = ((9, 12), (10, 10), (10, 14), (12, 9), (12, 12), (14, 10), (13, 13))
LAYOUTS = ("open", "pillars", "cross", "bars", "corners", "scattered")
EDGES = ("deadly", "wrap")
STEERING = ("compass", "turns")
PACES = ("slow", "fast", "quickening", "walk")
MEALS = ("single", "several", "moving", "fading", "poisoned")
GROWTHS = ("one", "three", "trail")
HUNGER = ("none", "hungry")
GOALS = ("meals", "length")
BUTTONS = ("none", "dash", "brake")
PAY = ("meals", "approach", "goal")
_PLACES = {
    "open": "an open field",
    "pillars": "a field of pillars",
    "cross": "a field with a cross",
    "bars": "a field with two bars",
    "corners": "a field with blocked corners",
    "scattered": "a field of scattered stones",
}


@dataclass(frozen=True)
class Snake(Variant):
    """A snake game."""

    size: tuple[int, int]
    layout: str
    edge: str
    steering: str
    pace: str
    meals: str
    growth: str
    hunger: str
    goal: str
    button: str
    pay: str

    axes: ClassVar[dict[str, str]] = {
        "board": "9 to 14 rows and columns",
        "layout": "open; with pillars, a cross, bars, blocked corners or scattered stones",
        "edge": "deadly, or the opposite edge follows",
        "steering": "by compass directions, or by turns to the left and right",
        "pace": "slow, fast, faster with each meal, or only while a direction is held",
        "meals": "one at a time, three at a time, moving, fading, or beside poison",
        "growth": "one or three segments a meal, or a trail that also grows with time",
        "hunger": "none, or a limit on the moves between meals",
        "goal": "a number of meals, or a length",
        "button": "none, a dash or a brake",
        "rewards": "for meals, for meals and approaching them, or for the goal alone",
        "look": "five themes, five styles of tiles, any hue",
    }

    @classmethod
    def draw(cls, rng: Random, difficulty: float) -> Self:
        size, layout, edge = rng.choice(SIZES), rng.choice(LAYOUTS), rng.choice(EDGES)
        steering, pace, meals = rng.choice(STEERING), rng.choice(PACES), rng.choice(MEALS)
        growth, hunger, goal = rng.choice(GROWTHS), rng.choice(HUNGER), rng.choice(GOALS)
        button, pay = rng.choice(BUTTONS), rng.choice(PAY)
        # A snake that grows with time would reach a length without eating, and an approach to moving food could be
        # repeated for a reward.
        goal = "meals" if growth == "trail" else goal
        pay = "meals" if pay == "approach" and meals in ("moving", "fading") else pay
        look = Look.draw(rng)
        return cls(difficulty, look, size, layout, edge, steering, pace, meals, growth, hunger, goal, button, pay)

    @property
    def title(self) -> str:
        edge = " without edges" if self.edge == "wrap" else ""
        return f"Snake in {_PLACES[self.layout]}{edge}"

    @property
    def wanted(self) -> int:
        """The meals that the goal takes."""
        return round(between(1, 10 if self.growth == "three" else 14, self.difficulty))

    def write_rules(self, code: SourceBuilder) -> None:
        rows, columns = self.size
        cell = min(76 // rows, 80 // columns)
        code.add("constants", f"ROWS, COLUMNS = {rows}, {columns}", f"MEALS = {self.wanted}", "# In pixels.")
        code.add("constants", f"CELL, TOP, LEFT = {cell}, {3 + (76 - cell * rows) // 2}, {(84 - cell * columns) // 2}")
        code.add("constants", "# Up, down, left and right, in rows and columns.")
        code.add("constants", "DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))")
        code.add("story", f"A snake crawls over {rows} rows of {columns} cells. It rests until the first direction.")
        self._write_layout(code)
        code.add("reset", "self.body = [(ROWS // 2, COLUMNS // 2)]", "self.heading = self.wanted = DIRECTIONS[0]")
        code.add("reset", "self.moving = False", "self.clock = self.growing = self.meals = 0")
        self._write_steering(code)
        self._write_pace(code)
        self._write_move(code)
        self._write_meals(code)
        self._write_goal(code)
        self._write_look(code)
        code.add("info", '"meals": self.meals, "length": len(self.body)')
        code.add("state", '"rows": ROWS,', '"columns": COLUMNS,', '"walls": [row[:] for row in self.walls],')
        code.add("state", '"body": self.body[:],', '"heading": self.heading,', '"growing": self.growing,')
        code.add("state", '"food": self.food[:],', f'"poison": {"self.poison[:]" if self._poisoned else "[]"},')
        code.add("state", f'"wrap": {self.edge == "wrap"},', f'"turns": {self.steering == "turns"},')

    @property
    def _poisoned(self) -> bool:
        return self.meals == "poisoned"

    def _write_layout(self, code: SourceBuilder) -> None:
        rows, columns = self.size
        y0, x0 = rows // 2, columns // 2
        stones: set[tuple[int, int]] = set()
        if self.layout == "pillars":
            stones = {(y, x) for y in range(2, rows - 1, 3) for x in range(2, columns - 1, 4)}
        elif self.layout == "cross":
            stones = {(y, x0) for y in range(2, rows - 2)} | {(y0, x) for x in range(2, columns - 2)}
            stones = {(y, x) for y, x in stones if abs(y - y0) > 1 or abs(x - x0) > 1}
        elif self.layout == "bars":
            stones = {(y, x) for y in (2, rows - 3) for x in range(2, columns - 2)}
        elif self.layout == "corners":
            stones = {(y, x) for y in (0, 1, rows - 2, rows - 1) for x in (0, 1, columns - 2, columns - 1)}
        stones.discard((y0, x0))
        if self.layout == "scattered":
            code.add("reset", "self.walls = [[False] * COLUMNS for _ in range(ROWS)]", "self._scatter()")
            code.add(
                "methods",
                """
                def _scatter(self) -> None:
                    \"\"\"Lay stones that do not touch each other, the edge or the start.\"\"\"
                    for _ in range(STONES):
                        y, x = int(self.np_random.integers(1, ROWS - 1)), int(self.np_random.integers(1, COLUMNS - 1))
                        near = [self.walls[y + down][x + right] for down in (-1, 0, 1) for right in (-1, 0, 1)]
                        if not any(near) and max(abs(y - ROWS // 2), abs(x - COLUMNS // 2)) > 1:
                            self.walls[y][x] = True
                """,
            )
            code.add("constants", f"STONES = {rows * columns // 8}")
        elif stones:
            art = ["".join("#" if (y, x) in stones else "." for x in range(columns)) for y in range(rows)]
            code.add("constants", "FIELD = (", *(f'    "{row}",' for row in art), ")")
            code.add("reset", 'self.walls = [[mark == "#" for mark in row] for row in FIELD]')
        else:
            code.add("reset", "self.walls = [[False] * COLUMNS for _ in range(ROWS)]")
        if self.layout != "open":
            code.add("story", "Stones are deadly.")

    def _write_steering(self, code: SourceBuilder) -> None:
        if self.steering == "compass":
            code.add("controls", "The four directions steer; the snake cannot turn back.")
            code.add(
                "advance",
                """
                if direction:
                    self.moving = True
                    y, x = DIRECTIONS[direction - 1]
                    if len(self.body) == 1 or (y, x) != (-self.heading[0], -self.heading[1]):
                        self.wanted = (y, x)
                """,
            )
            return
        code.add("controls", "Left and right turn the snake, and up and down keep it straight.")
        code.add(
            "advance",
            """
            if direction:
                self.moving = True
                y, x = self.heading
                self.wanted = {3: (-x, y), 4: (x, -y)}.get(direction, (y, x))
            """,
        )

    def _write_pace(self, code: SourceBuilder) -> None:
        code.add("advance", "if not self.moving:", "    return")
        if self.button == "brake":
            code.add("controls", "The second button stops the snake while it is held.")
            code.add("advance", "if second:", "    return")
        if self.pace == "walk":
            code.add("story", "It moves one cell every other step while a direction is held.")
            code.add("constants", "PACE = 2")
            code.add("advance", "if not direction:", "    return")
        elif self.pace == "quickening":
            code.add("story", "It moves one cell every 4 steps, a step sooner after every second meal.")
        else:
            pace = {"slow": 3, "fast": 2}[self.pace]
            code.add("story", f"It moves one cell every {pace} steps.")
            code.add("constants", f"PACE = {pace}")
        pace_now = "max(1, 4 - self.meals // 2)" if self.pace == "quickening" else "PACE"
        dash = ""
        if self.button == "dash":
            code.add("controls", "The first button makes it move at every step.")
            dash = " and not first"
        code.add("advance", "self.clock += 1", f"if self.clock < {pace_now}{dash}:", "    return", "self.clock = 0")
        code.add("advance", "self._move()")

    def _write_move(self, code: SourceBuilder) -> None:
        if self.edge == "wrap":
            code.add("story", "Beyond an edge it comes in at the opposite one.")
            edge = "y, x = y % ROWS, x % COLUMNS"
            over = "self.walls[y][x] or (y, x) in body"
        else:
            code.add("story", "The edge is deadly.")
            over = "not (0 <= y < ROWS and 0 <= x < COLUMNS) or self.walls[y][x] or (y, x) in body"
            edge = ""
        code.add("story", "The snake dies when it bites itself.")
        code.add("crossed", *([edge] if edge else []))
        code.add("deadly", over)
        code.add(
            "methods",
            """
            def _move(self) -> None:
                self.heading = self.wanted
                <<before>>
                y, x = self.body[0][0] + self.heading[0], self.body[0][1] + self.heading[1]
                <<crossed>>
                body = self.body if self.growing else self.body[:-1]
                if <<deadly>>:
                    self.lost = True
                    return
                self.body = [(y, x), *body]
                self.growing = max(0, self.growing - 1)
                <<entered>>
            """,
        )

    def _write_meals(self, code: SourceBuilder) -> None:
        grows = 3 if self.growth == "three" else 1
        code.add("story", f"It grows by {grows} with each meal.")
        code.add("constants", f"GROWTH = {grows}")
        if self.growth == "trail":
            code.add("story", "It also grows by 1 every 12 moves, up to 30 cells.")
            code.add("reset", "self.moves = 0")
            code.add(
                "before", "self.moves += 1", "if self.moves % 12 == 0 and len(self.body) < 30:", "    self.growing += 1"
            )
        count = 3 if self.meals == "several" else 1
        if count > 1:
            code.add("story", f"There are {count} meals at a time.")
        if self._poisoned:
            code.add("reset", "self.poison: list[tuple[int, int]] = []")
        code.add("reset", "self.food: list[tuple[int, int]] = []")
        code.add("reset", "self.food = [<<first>>]")
        code.add("first", *["self._free()"] * count)
        free = "self.food + self.poison" if self._poisoned else "self.food"
        code.add(
            "methods",
            f"""
            def _free(self) -> tuple[int, int]:
                \"\"\"A random cell that holds nothing.\"\"\"
                taken = set(self.body + {free})
                cells = [
                    (y, x) for y in range(ROWS) for x in range(COLUMNS) if not self.walls[y][x] and (y, x) not in taken
                ]
                return cells[int(self.np_random.integers(len(cells)))]
            """,
        )
        if self._poisoned:
            code.add(
                "story",
                "Two cells of poison, which are laid anew with each meal, kill it. They lie apart from all else.",
            )
            code.add("reset", "self._poison()")
            code.add("entered", "if (y, x) in self.poison:", "    self.lost = True")
            code.add(
                "methods",
                """
                def _poison(self) -> None:
                    \"\"\"Lay poison on cells with nothing around them, so that it blocks no way.\"\"\"
                    self.poison = []
                    for _ in range(2):
                        y, x = self._free()
                        around = [(y + down, x + right) for down in (-1, 0, 1) for right in (-1, 0, 1)]
                        inside = 0 < y < ROWS - 1 and 0 < x < COLUMNS - 1
                        if inside and not any(
                            self.walls[row][column] or (row, column) in self.food + self.poison + self.body
                            for row, column in around
                        ):
                            self.poison.append((y, x))
                """,
            )
        fed = ["self.meals += 1", "self.growing += GROWTH", "self.food[self.food.index((y, x))] = self._free()"]
        if self._poisoned:
            fed += ["self._poison()"]
        if self.meals == "moving":
            code.add("story", "The meal moves to a free cell beside it every 3 moves of the snake.")
            code.add("reset", "self.crawl = 0")
            code.add(
                "before",
                """
                self.crawl = (self.crawl + 1) % 3
                if self.crawl == 0:
                    y, x = self.food[0]
                    down, right = DIRECTIONS[int(self.np_random.integers(4))]
                    y, x = y + down, x + right
                    if 0 <= y < ROWS and 0 <= x < COLUMNS and not self.walls[y][x] and (y, x) not in self.body:
                        self.food[0] = (y, x)
                """,
            )
        if self.meals == "fading":
            fade = sum(self.size) + 4
            code.add(
                "story", f"A meal lies elsewhere after {fade} moves; the bar on the right shows how many are left."
            )
            code.add("constants", f"FADING = {fade}")
            code.add("reset", "self.fading = FADING")
            code.add("before", "self.fading -= 1", "if self.fading <= 0:")
            code.add("before", "    self.food[0], self.fading = self._free(), FADING")
            fed += ["self.fading = FADING"]
        if self.hunger == "hungry":
            moves = round(between(5, 3, self.difficulty) * sum(self.size))
            code.add(
                "story", f"It starves after {moves} moves without a meal; the bar at the top shows how many are left."
            )
            code.add("constants", f"HUNGER = {moves}")
            code.add("reset", "self.hunger = HUNGER")
            fed += ["self.hunger = HUNGER"]
        if self.pay != "goal":
            fed += ["self.reward += 1.0"]
            code.add("paid", "+1 for each meal")
        if self.pay == "approach":
            code.add("paid", "+0.02 for each cell nearer to a meal and -0.02 for each farther")
            code.add("before", "near = self._distance()")
            code.add(
                "methods",
                """
                def _distance(self) -> int:
                    \"\"\"The distance to the nearest meal, in cells.\"\"\"
                    return min(abs(y - self.body[0][0]) + abs(x - self.body[0][1]) for y, x in self.food)
                """,
            )
            code.add("entered", "if (y, x) not in self.food:", "    self.reward += 0.02 * (near - self._distance())")
        code.add("entered", "if (y, x) in self.food:", *(f"    {line}" for line in fed))
        if self.hunger == "hungry":
            code.add("entered", "else:", "    self.hunger -= 1", "    self.lost = self.lost or self.hunger == 0")

    def _write_goal(self, code: SourceBuilder) -> None:
        if self.goal == "meals":
            code.add("aim", f"Eat {self.wanted} meals; the bar at the bottom shows how many are eaten.")
            code.add("progress", "self.meals / MEALS")
            code.add("entered", "self.won = not self.lost and self.meals >= MEALS")
        else:
            length = 1 + self.wanted * (3 if self.growth == "three" else 1)
            code.add("aim", f"Become {length} cells long; the bar at the bottom shows how long the snake is.")
            code.add("constants", f"LENGTH = {length}")
            code.add("progress", "len(self.body) / LENGTH")
            code.add("entered", "self.won = not self.lost and len(self.body) >= LENGTH")
        code.add("constants", "PRIZE, PENALTY = 5.0, 2.0")
        code.add("paid", "+5 for the goal", "-2 for dying")

    def _write_look(self, code: SourceBuilder) -> None:
        things = ["BODY", "HEAD", "FOOD", *(["POISON"] if self._poisoned else []), "BAR"]
        self.look.write_colours(code, things)
        self.look.write_tile(code)
        code.add(
            "tiles", "BODY_TILE, HEAD_TILE, STONE_TILE = (tile(colour, CELL, CELL) for colour in (BODY, HEAD, WALL))"
        )
        code.add("reset", "self.picture = self._backdrop()")
        code.add(
            "methods",
            """
            def _backdrop(self) -> NDArray[np.uint8]:
                \"\"\"What no step changes.\"\"\"
                picture = np.full((SIZE, SIZE, 3), PAGE)
                picture[TOP : TOP + CELL * ROWS, LEFT : LEFT + CELL * COLUMNS] = GROUND
                for y, row in enumerate(self.walls):
                    for x, stone in enumerate(row):
                        if stone:
                            self._put(picture, y, x, STONE_TILE)
                return picture

            def _put(self, picture: NDArray[np.uint8], y: int, x: int, pixels: NDArray[np.uint8]) -> None:
                top, left = TOP + CELL * y, LEFT + CELL * x
                picture[top : top + CELL, left : left + CELL] = pixels
            """,
        )
        code.add("draw", "frame = self.picture.copy()", "for y, x in self.food:", "    self._put(frame, y, x, FOOD)")
        if self._poisoned:
            code.add("draw", "for y, x in self.poison:", "    self._put(frame, y, x, POISON)")
        code.add(
            "draw",
            """
            for y, x in self.body[1:]:
                self._put(frame, y, x, BODY_TILE)
            y, x = self.body[0]
            self._put(frame, y, x, HEAD_TILE)
            # The eye looks ahead, and the dot in the corner counts the steps to the next move.
            middle = CELL // 2
            eye = TOP + CELL * y + middle * (1 + self.wanted[0]), LEFT + CELL * x + middle * (1 + self.wanted[1])
            frame[min(eye[0], TOP + CELL * y + CELL - 1), min(eye[1], LEFT + CELL * x + CELL - 1)] = PAGE
            frame[82, 2 * self.clock] = BAR
            frame[80, 10 : 10 + int(64 * min(1.0, <<progress>>))] = BAR
            """,
        )
        if self.hunger == "hungry":
            code.add("draw", "frame[1, 10 : 10 + 64 * self.hunger // HUNGER] = FOOD")
        if self.meals == "fading":
            code.add("draw", "frame[10 : 10 + 64 * self.fading // FADING, 83] = FOOD")
