"""The family `breakout`: a paddle, a ball and a wall of bricks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import ClassVar, Self

from envcraft.environments.source_builder import SourceBuilder
from envcraft_families.breakout_code import BOUNCE, DRAW, FLY, HIT, SERVE
from envcraft_families.look import SIDES, Look
from envcraft_families.variant import Variant, between

PATTERNS = ("full", "checks", "columns", "pyramid", "arch", "gaps")
ARMOURS = ("plain", "top", "stripes")
AIMS = ("offset", "english", "thirds")
SERVES = ("button", "move")
PRESSURES = ("none", "quicker", "sinking")
GOALS = ("count", "jewels")
BUTTONS = ("none", "dash", "brake")
PAY = ("bricks", "depth", "goal")
ROWS, COLUMNS = 5, 8
_BRICKS = {
    "full": "a full wall",
    "checks": "a chequered wall",
    "columns": "columns of bricks",
    "pyramid": "a pyramid",
    "arch": "an arch",
    "gaps": "a wall with gaps",
}


@dataclass(frozen=True)
class Breakout(Variant):
    """A game with a paddle, a ball and bricks."""

    side: str
    pattern: str
    armour: str
    aim: str
    serve: str
    pressure: str
    goal: str
    button: str
    pay: str

    axes: ClassVar[dict[str, str]] = {
        "side": "the paddle is at the bottom, at the top, on the left or on the right",
        "bricks": "full, chequered, columns, a pyramid, an arch, or random gaps",
        "armour": "none, or two hits for the far rows or for every other row",
        "aim": "the ball leaves by where it hits the paddle, by how the paddle moves, or by its thirds",
        "serve": "with a button, or as soon as the paddle moves",
        "pressure": "none, a ball that gets quicker, or bricks that come nearer",
        "goal": "a number of bricks, or all jewels among them",
        "button": "none, a dash or a brake",
        "rewards": "for bricks, more for far bricks, or for the goal alone",
        "look": "five themes, five styles of bricks, any hue",
    }

    @classmethod
    def draw(cls, rng: Random, difficulty: float) -> Self:
        look = Look.draw(rng)
        side, pattern, armour = rng.choice(tuple(SIDES)), rng.choice(PATTERNS), rng.choice(ARMOURS)
        aim, serve, pressure = rng.choice(AIMS), rng.choice(SERVES), rng.choice(PRESSURES)
        goal, button, pay = rng.choice(GOALS), rng.choice(BUTTONS), rng.choice(PAY)
        return cls(difficulty, look, side, pattern, armour, aim, serve, pressure, goal, button, pay)

    @property
    def title(self) -> str:
        place = {"bottom": "above", "top": "below", "left": "to the right of", "right": "to the left of"}[self.side]
        return f"A ball against {_BRICKS[self.pattern]} {place} the paddle"

    @property
    def wanted(self) -> int:
        """The bricks to break."""
        return round(between(2, 18, self.difficulty))

    def write_rules(self, code: SourceBuilder) -> None:
        wanted = self.wanted
        width = round(between(20, 14, self.difficulty))
        lives = 2
        code.add("constants", "# In pixels, as seen with the paddle at the bottom.")
        code.add("constants", f"PADDLE, BALL, FLOOR, CEILING = {width}, 3, 78, 5")
        code.add("constants", f"ROWS, COLUMNS, HEIGHT, WIDTH = {ROWS}, {COLUMNS}, 5, 10")
        code.add("constants", "# In pixels per step: along the paddle, and towards the bricks.", "SPEED, RISE = 4, 3")
        code.add("constants", f"LIVES, WANTED = {lives}, {wanted}")
        code.add("story", f"A paddle at the {self.side} keeps a ball in play. The ball breaks {_BRICKS[self.pattern]}.")
        code.add("story", f"The ball is lost when it passes the paddle. There are {lives} balls.")
        code.add("reset", "self.lives, self.broken = LIVES, 0", "self.paddle = (SIZE - PADDLE) // 2", "self.drift = 0")
        code.add("reset", "self.top = CEILING + 4")
        self._write_bricks(code)
        self._write_paddle(code)
        self._write_ball(code)
        self._write_goal(code)
        self._write_look(code)
        code.add("info", '"broken": self.broken, "lives": self.lives')
        code.add("state", '"paddle": self.paddle, "ball": list(self.ball), "velocity": list(self.velocity),')
        code.add("state", '"bricks": [row[:] for row in self.bricks], "lives": self.lives, "held": self.held,')

    def _write_bricks(self, code: SourceBuilder) -> None:
        middle = (COLUMNS - 1) / 2
        shapes: dict[str, Callable[[int, int], bool]] = {
            "full": lambda y, x: True,
            "checks": lambda y, x: (y + x) % 2 == 0,
            "columns": lambda y, x: x % 2 == 0 or y == 2,
            "pyramid": lambda y, x: abs(x - middle) < ROWS - y,
            "arch": lambda y, x: y < 2 or x in (0, 1, COLUMNS - 2, COLUMNS - 1),
            "gaps": lambda y, x: True,
        }
        shape, tough = shapes[self.pattern], {"plain": (), "top": (0,), "stripes": (1, 3)}[self.armour]
        art = [
            "".join(("2" if y in tough else "1") if shape(y, x) else "." for x in range(COLUMNS)) for y in range(ROWS)
        ]
        code.add("constants", "# The hits that each brick takes, from the farthest row to the nearest.")
        code.add("constants", "WALL_OF_BRICKS = (", *(f'    "{row}",' for row in art), ")")
        code.add("reset", 'self.bricks = [[int(mark) if mark != "." else 0 for mark in row] for row in WALL_OF_BRICKS]')
        if self.pattern == "gaps":
            code.add("story", "A third of the bricks is missing, others in each episode.")
            code.add("reset", "for row in self.bricks:", "    for column in self.np_random.permutation(COLUMNS)[:3]:")
            code.add("reset", "        row[int(column)] = 0")
        if self.armour != "plain":
            code.add("story", "Bright bricks take two hits.")

    def _write_paddle(self, code: SourceBuilder) -> None:
        back, forth = ("left", "right") if self.side in ("bottom", "top") else ("up", "down")
        code.add("controls", f"{back.capitalize()} and {forth} move the paddle.")
        less, more = (3, 4) if self.side in ("bottom", "top") else (1, 2)
        code.add("constants", f"LESS, MORE = {less}, {more}")
        speed = "SPEED"
        if self.button == "dash":
            code.add("controls", "With the first button it moves twice as fast.")
            speed = "(2 * SPEED if first else SPEED)"
        elif self.button == "brake":
            code.add("controls", "With the first button it moves by single pixels.")
            speed = "(1 if first else SPEED)"
        code.add("advance", f"self.drift = ((direction == MORE) - (direction == LESS)) * {speed}")
        code.add("advance", "self.paddle = max(0, min(SIZE - PADDLE, self.paddle + self.drift))")

    def _write_ball(self, code: SourceBuilder) -> None:
        code.add("reset", "self._serve()")
        code.add("methods", SERVE, FLY, HIT)
        code.add("aimed", *BOUNCE[self.aim])
        how = {
            "offset": "The ball leaves the paddle the more aslant, the farther from the middle it hits.",
            "english": "The paddle turns the ball to the side to which it moves.",
            "thirds": "The left, middle and right third of the paddle send the ball aslant, straight and aslant.",
        }
        code.add("story", how[self.aim])
        code.add("advance", "if self.held:")
        if self.serve == "button":
            code.add("story", "The ball rests on the paddle until the second button serves it.")
            code.add("controls", "The second button serves the ball.")
            code.add("advance", "    self.held = not second")
        else:
            code.add("story", "The ball rests on the paddle until the paddle moves.")
            code.add("advance", "    self.held = not self.drift")
        code.add("advance", "    self.ball[0] = self.paddle + (PADDLE - BALL) // 2", "    return")
        speed = "RISE"
        if self.pressure == "quicker":
            code.add("story", "After every 4 bricks the ball gets quicker, up to twice.")
            speed = "RISE + min(2, self.broken // 4)"
        elif self.pressure == "sinking":
            code.add("story", "The bricks come a pixel nearer every 25 steps, up to 25 pixels.")
            code.add("advance", "if self.steps % 25 == 0 and self.top < CEILING + 29:", "    self.top += 1")
        code.add("rise", speed)
        code.add("advance", "self._fly()")

    def _write_goal(self, code: SourceBuilder) -> None:
        wanted = self.wanted
        code.add("constants", "PRIZE, PENALTY = 5.0, 2.0")
        if self.goal == "jewels":
            jewels = max(1, wanted // 3)
            code.add("constants", f"JEWELS = {jewels}")
            code.add(
                "aim", f"Break the {jewels} bricks with a jewel." if jewels > 1 else "Break the brick with a jewel."
            )
            code.add(
                "reset", "places = [(y, x) for y, row in enumerate(self.bricks) for x, hits in enumerate(row) if hits]"
            )
            code.add("reset", "chosen = self.np_random.permutation(len(places))[:JEWELS]")
            code.add("reset", "self.jewels = [places[int(place)] for place in chosen]")
            code.add("broke", "if (row, column) in self.jewels:", "    self.jewels.remove((row, column))")
            code.add("broke", "self.won = not self.jewels")
            code.add("state", '"jewels": self.jewels[:],')
        else:
            code.add("aim", f"Break {wanted} bricks; the bar at the edge shows how many are broken.")
            code.add("broke", "self.won = self.broken >= WANTED")
        if self.pay == "bricks":
            code.add("paid", "+1 for each brick")
            code.add("broke", "self.reward += 1.0")
        elif self.pay == "depth":
            code.add("paid", "+0.5 for a brick of the nearest row and 0.5 more for each row behind")
            code.add("broke", "self.reward += 0.5 * (ROWS - row)")
        code.add("paid", "+5 for the goal", "-2 for the loss of the last ball")

    def _write_look(self, code: SourceBuilder) -> None:
        things = ["PADDLE_COLOUR", "BRICK", "BALL_COLOUR", *(["JEWEL"] if self.goal == "jewels" else []), "BAR"]
        self.look.write_colours(code, things)
        self.look.write_tile(code)
        code.add("tiles", "TILES = (tile(GROUND, HEIGHT - 1, WIDTH - 1), tile(BRICK, HEIGHT - 1, WIDTH - 1))")
        code.add("tiles", "TOUGH = 255 - (255 - TILES[1]) // 2", "BACKDROP = np.full((SIZE, SIZE, 3), GROUND)")
        code.add("tiles", "BACKDROP[:CEILING] = PAGE")
        code.add("draw", *DRAW)
        if self.goal == "jewels":
            code.add(
                "draw",
                """
                for row, column in self.jewels:
                    top, left = self.top + HEIGHT * row + 1, 2 + WIDTH * column + 3
                    frame[top : top + 2, left : left + 3] = JEWEL
                """,
            )
        else:
            code.add("draw", "frame[3, 2 : 2 + 80 * min(self.broken, WANTED) // WANTED] = BAR")
        if SIDES[self.side]:
            code.add("draw", SIDES[self.side])
