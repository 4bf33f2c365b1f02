"""The family `maze`: a maze with keys and doors."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import ClassVar, Self

from envcraft.environments.source_builder import SourceBuilder
from envcraft_families.look import Look
from envcraft_families.maze_code import BUILD, CARVE, DISTANCES, DRAW, ENTER, LOOPS, PITS
from envcraft_families.variant import Variant, between

GROWTHS = ("winding", "branching", "mixed")
ROOMS = ("corridors", "corridors", "chambers")
LOOP = (False, True)
LOCKS = ("coloured", "plain")
DOORS = ("touch", "button")
GOALS = ("exit", "gems", "return")
HAZARDS = ("none", "pits", "spikes")
CONTROLS = ("compass", "tank", "run")
PACES = (1, 1, 2)
PAY = ("milestones", "time", "goal")
_MANNERS = {"winding": "a winding maze", "branching": "a branching maze", "mixed": "a maze"}
_GOALS = {"exit": "", "gems": " with gems", "return": ", and back"}
#: How many steps the walker's controls cost for each cell, at most.
_COST = {"compass": 1.0, "tank": 1.7, "run": 1.0}


@dataclass(frozen=True)
class Maze(Variant):
    """A maze game. `wide` is what the maze is wider than high, in rooms."""

    growth: str
    rooms: str
    wide: int
    loops: bool
    locks: str
    doors: str
    goal: str
    hazard: str
    controls: str
    pace: int
    pay: str

    axes: ClassVar[dict[str, str]] = {
        "maze": "winding, branching or mixed; corridors or chambers; higher, square or wider; with or without loops",
        "keys": "one to three, each for the door of its colour, or all alike",
        "doors": "open at a touch, or with a button",
        "goal": "reach the exit, collect gems first, or fetch a treasure",
        "hazard": "none, pits in dead ends, or spikes that come and go",
        "controls": "compass directions, turns and steps, or runs to the next crossing",
        "pace": "a move at every step, or at every other",
        "rewards": "for keys, doors and gems; the same with a price for time; or for the goal alone",
        "look": "five themes, five styles of tiles, any hue",
    }

    @classmethod
    def draw(cls, rng: Random, difficulty: float) -> Self:
        growth, rooms, wide = rng.choice(GROWTHS), rng.choice(ROOMS), rng.choice((-1, 0, 1))
        loops, locks, doors, goal = rng.choice(LOOP), rng.choice(LOCKS), rng.choice(DOORS), rng.choice(GOALS)
        hazard, controls, pay = rng.choice(HAZARDS), rng.choice(CONTROLS), rng.choice(PAY)
        pace, look = rng.choice(PACES), Look.draw(rng)
        # With a way around each, spikes would hold up nobody.
        loops = loops and hazard != "spikes"
        # Runs are few.
        pace = 1 if controls == "run" else pace
        # To turn before spikes takes longer than they stay down.
        hazard = "pits" if hazard == "spikes" and controls == "tank" else hazard
        return cls(difficulty, look, growth, rooms, wide, loops, locks, doors, goal, hazard, controls, pace, pay)

    @property
    def title(self) -> str:
        place = _MANNERS[self.growth] if self.rooms == "corridors" else f"{self.growth} chambers"
        return f"Keys and doors in {place}{_GOALS[self.goal]}"

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of rooms."""
        if self.rooms == "chambers":
            side = round(between(3, 4, self.difficulty))
            return side, side
        side = round(between(4, 7, self.difficulty))
        return side + (self.wide < 0), side + (self.wide > 0)

    def write_rules(self, code: SourceBuilder) -> None:
        room = 3 if self.rooms == "chambers" else 1
        rows, columns = ((room + 1) * side + 1 for side in self.size)
        cell = min(76 // rows, 80 // columns)
        keys = round(between(1, 2 if room == 3 else 3, self.difficulty))
        slack = 20 * (1.8 / 20) ** self.difficulty * self.pace * _COST[self.controls]
        code.add("constants", "# In rooms, in cells and in pixels. A gate is STEP cells from the middle of its rooms.")
        code.add("constants", f"WIDTH, ROWS, COLUMNS, STEP = {self.size[1]}, {rows}, {columns}, {room // 2 + 1}")
        code.add("constants", f"CELL, TOP, LEFT = {cell}, {3 + (76 - cell * rows) // 2}, {(84 - cell * columns) // 2}")
        code.add("constants", "# Up, down, left and right, in rows and columns.")
        code.add("constants", "DIRECTIONS = ((-1, 0), (1, 0), (0, -1), (0, 1))", f"KEYS = {keys}")
        code.add("constants", f"SLACK, LEAST, MOST = {slack:.2f}, 90, 960")
        many = "A key lies" if keys == 1 else f"{keys} keys lie"
        what = {"corridors": "a maze", "chambers": "chambers"}[self.rooms]
        code.add("story", f"A walker is in {what} of {self.size[0]} by {self.size[1]} rooms, new in each episode.")
        code.add("story", f"{many} there, and as many doors are locked.")
        code.add("story", "A key opens the door of its colour." if self._coloured else "A key opens any door, once.")
        code.add("kind", "number" if self._coloured else "0")
        code.add("numbered", "number, door in enumerate(doors)" if self._coloured else "door in doors")
        code.add("reset", "self._build()", "self.held: list[int] = []")
        code.add("methods", BUILD, CARVE, DISTANCES)
        place = {
            "winding": "-1",
            "branching": "int(self.np_random.integers(len(waiting)))",
            "mixed": "-1 if self.np_random.random() < 0.6 else int(self.np_random.integers(len(waiting)))",
        }
        code.add("grow", place[self.growth])
        if self.loops:
            code.add("story", "Some ways meet again.")
            code.add("built", LOOPS)
        self._write_hazard(code)
        self._write_controls(code)
        self._write_goal(code)
        self._write_look(code)
        code.add("info", '"keys": len(self.held), "doors": len(self.doors)')
        code.add("state", '"walls": [row[:] for row in self.walls],', '"player": self.player, "facing": self.facing,')
        code.add("state", '"held": self.held[:], "keys": dict(self.keys), "doors": dict(self.doors),')
        period = 8 if self.hazard == "spikes" else 1
        turns = self.controls == "tank"
        code.add("state", f'"energy": self.energy, "pace": {self.pace}, "turns": {turns}, "period": {period},')

    @property
    def _coloured(self) -> bool:
        return self.locks == "coloured"

    def _write_hazard(self, code: SourceBuilder) -> None:
        if self.hazard == "pits":
            code.add("story", "Who steps into a pit is lost.")
            code.add("built", PITS)
            code.add("pits", "for y, x in self.pits:", "    self._put(picture, y, x, DANGER)")
            code.add("entered", "if (y, x) in self.pits:", "    self.lost = True", "    return False")
        elif self.hazard == "spikes":
            code.add(
                "story",
                "Spikes rise for 3 steps and sink for 5; the line at the bottom shows the time to the next change.",
            )
            code.add("constants", "PERIOD, RAISED = 8, 3")
            code.add(
                "built",
                """
                self.spikes = [gate for gate in gates if gate not in doors][::4]
                """,
            )
            code.add("advance", "self.raised = self.steps % PERIOD < RAISED")
            code.add("advance", "if self.raised and self.player in self.spikes:", "    self.lost = True", "    return")
            code.add("reset", "self.raised = True")
            code.add("entered", "if self.raised and (y, x) in self.spikes:", "    self.lost = True", "    return False")

    def _write_controls(self, code: SourceBuilder) -> None:
        code.add("reset", "self.facing = DIRECTIONS[0]")
        code.add("advance", "self.energy -= 1")
        if self.pace > 1:
            code.add("story", f"The walker acts at every step whose number is a multiple of {self.pace}.")
            code.add("constants", f"PACE = {self.pace}")
            code.add("advance", "if self.steps % PACE == 0:", "    self._walk(direction, first)")
        else:
            code.add("advance", "self._walk(direction, first)")
        code.add("advance", "if self.energy == 0 and not self.won:", "    self.lost = True")
        if self.controls == "compass":
            code.add("controls", "The four directions move the walker by a cell.")
            walk = """
            def _walk(self, direction: int, first: int) -> None:
                if direction:
                    self.facing = DIRECTIONS[direction - 1]
                    self._enter(self.player[0] + self.facing[0], self.player[1] + self.facing[1], first)
            """
        elif self.controls == "tank":
            code.add(
                "controls", "Up and down move the walker forwards and backwards by a cell; left and right turn it."
            )
            walk = """
            def _walk(self, direction: int, first: int) -> None:
                down, right = self.facing
                if direction in (1, 2):
                    sign = 1 if direction == 1 else -1
                    self._enter(self.player[0] + sign * down, self.player[1] + sign * right, first)
                elif direction:
                    self.facing = (-right, down) if direction == 3 else (right, -down)
            """
        else:
            code.add("controls", "The walker runs in one of the four directions to the next crossing, door or thing.")
            walk = """
            def _walk(self, direction: int, first: int) -> None:
                if not direction:
                    return
                down, right = self.facing = DIRECTIONS[direction - 1]
                running = True
                while running and not (self.won or self.lost):
                    y, x = self.player[0] + down, self.player[1] + right
                    thing = (y, x) in (self.start, self.exit, *<<things>>)
                    # A crossing has a way to one side.
                    running = self._enter(y, x, first) and not thing
                    running = running and self.walls[y + right][x + down] and self.walls[y - right][x - down]
            """
        code.add("methods", walk)
        code.add("things", "self.keys", "*self.doors", *(["*self.gems"] if self.goal == "gems" else []))
        if self.doors == "button":
            code.add("controls", "The first button opens the door that the walker moves against.")
            code.add("open", "kind not in self.held or not first")
        else:
            code.add("controls", "A door opens when the walker moves against it.")
            code.add("open", "kind not in self.held")

    def _write_goal(self, code: SourceBuilder) -> None:
        gems = 2 + round(self.difficulty) if self.goal == "gems" else 0
        code.add("constants", f"PRIZE, PENALTY, FOUND = 5.0, 1.0, {0.0 if self.pay == 'goal' else 1.0}")
        code.add("stops", "*self.keys", *(["*self.gems"] if gems else []), "self.exit")
        if self.goal == "return":
            code.add("aim", "Fetch the treasure and bring it to the start, before the energy is used up.")
            code.add("reset", "self.treasure = False")
            code.add("entered", "if (y, x) == self.exit:", "    self.treasure = True")
            code.add("entered", "if (y, x) == self.start and self.treasure:", "    self.won = True")
            code.add("stops", "self.start")
            code.add("state", '"treasure": self.treasure,')
        elif self.goal == "gems":
            code.add("aim", f"Collect {gems} gems and reach the exit, before the energy is used up.")
            code.add("entered", "if (y, x) == self.exit and not self.gems:", "    self.won = True")
            code.add("constants", f"GEMS = {gems}")
            code.add("gems", "self.gems = [free[int(place)] for place in self.np_random.permutation(len(free))[:GEMS]]")
            code.add("gems", "free = [cell for cell in free if cell not in self.gems]")
            code.add("picked", "if (y, x) in self.gems:", "    self.gems.remove((y, x))", "    self.reward += FOUND")
            code.add("state", '"gems": self.gems[:],')
            code.add("draw_gems", "for y, x in self.gems:", "    self._put(frame, y, x, GEM, 2)")
        else:
            code.add("aim", "Reach the exit before the energy is used up.")
            code.add("entered", "if (y, x) == self.exit:", "    self.won = True")
        code.add("aim", "The bar at the top shows the energy.")
        if self.pay != "goal":
            code.add("paid", "+1 for each key, +1 for each door" + (", +1 for each gem" if gems else ""))
        if self.pay == "time":
            code.add("paid", "-0.005 at each step")
            code.add("step_reward", "-0.005")
        code.add("paid", "+5 for the goal", "-1 for losing")

    def _write_look(self, code: SourceBuilder) -> None:
        things = [
            "WALKER",
            "EXIT",
            "FIRST",
            "SECOND",
            "THIRD",
            *(["GEM"] if self.goal == "gems" else []),
            *(["DANGER"] if self.hazard != "none" else []),
        ]
        self.look.write_colours(code, things)
        self.look.write_tile(code)
        code.add(
            "tiles", "WALL_TILE, WALKER_TILE, EXIT_TILE = (tile(colour, CELL, CELL) for colour in (WALL, WALKER, EXIT))"
        )
        code.add("tiles", "LOCKS, EYE = (FIRST, SECOND, THIRD), (CELL - 1) // 2")
        code.add("reset", "self.picture = self._backdrop()")
        code.add("methods", ENTER, *DRAW)
        code.add(
            "draw",
            """
            frame = self.picture.copy()
            for (y, x), kind in self.doors.items():
                self._put(frame, y, x, LOCKS[kind])
            for (y, x), kind in self.keys.items():
                self._put(frame, y, x, LOCKS[kind], CELL // 2)
            <<draw_gems>>
            """,
        )
        if self.goal == "return":
            code.add("draw", "self._put(frame, *(self.start if self.treasure else self.exit), EXIT_TILE)")
        else:
            code.add("draw", "self._put(frame, *self.exit, EXIT_TILE)")
        if self.hazard == "spikes":
            code.add("draw", "for y, x in self.spikes:")
            code.add("draw", "    self._put(frame, y, x, DANGER, CELL if self.raised else 1)")
            code.add("draw", "frame[82, 10 : 12 + 4 * (PERIOD - self.steps % PERIOD)] = DANGER")
        code.add(
            "draw",
            """
            y, x = self.player
            self._put(frame, y, x, WALKER_TILE)
            # The eye looks ahead.
            eye = TOP + CELL * y + EYE * (1 + self.facing[0]), LEFT + CELL * x + EYE * (1 + self.facing[1])
            frame[eye] = PAGE
            frame[1, 10 : 10 + 64 * self.energy // self.full] = EXIT
            for number, kind in enumerate(self.held):
                frame[81:84, 2 + 3 * number : 4 + 3 * number] = LOCKS[kind]
            """,
        )
        if self.pace > 1:
            code.add("draw", "frame[83, 80 + 2 * (self.steps % PACE)] = WALL")
