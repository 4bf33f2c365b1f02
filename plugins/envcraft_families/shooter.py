"""The family `shooter`: a ship that shoots down what comes."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from typing import ClassVar, Self

from envcraft.environments.source_builder import SourceBuilder
from envcraft_families.look import SIDES, Look
from envcraft_families.shooter_code import ADVANCE, BRING, DRAW, FIRE, FLY, MOVES
from envcraft_families.variant import Variant, between

ENEMIES = ("march", "rain", "weave", "patrol", "giant")
FIRES = ("none", "straight", "aimed")
WEAPONS = ("single", "twin", "heavy")
MOTIONS = ("firm", "gliding")
BUTTONS = ("none", "dash", "brake")
PAY = ("kills", "thrift", "goal")
_NAMES = {
    "march": "a marching block",
    "rain": "falling raiders",
    "weave": "weaving raiders",
    "patrol": "patrols",
    "giant": "a giant",
}
_STORY = {
    "march": "A block of eight enemies marches to and fro, and comes nearer at each turn. A new block follows.",
    "rain": "Enemies come straight on, one after the other.",
    "weave": "Enemies come on in zigzags, one after the other.",
    "patrol": "Three enemies fly to and fro at different distances. A new one follows each.",
    "giant": "A giant flies to and fro.",
}


@dataclass(frozen=True)
class Shooter(Variant):
    """A shooting game. `armour` is the number of hits that an enemy takes."""

    side: str
    enemies: str
    armour: int
    fire: str
    weapon: str
    motion: str
    button: str
    pay: str

    axes: ClassVar[dict[str, str]] = {
        "side": "the ship is at the bottom, at the top, on the left or on the right",
        "enemies": "a marching block, falling or weaving raiders, patrols, or a giant",
        "armour": "an enemy takes one or two hits",
        "fire": "enemies do not shoot, shoot straight, or aim",
        "weapon": "single, twin or heavy shots, always with little ammunition",
        "motion": "the ship stops at once, or glides",
        "button": "none, a dash or a brake",
        "rewards": "for kills, for kills with a price for each shot, or for the goal alone",
        "look": "five themes, five styles of ships, any hue",
    }

    @classmethod
    def draw(cls, rng: Random, difficulty: float) -> Self:
        look, side, enemies = Look.draw(rng), rng.choice(tuple(SIDES)), rng.choice(ENEMIES)
        armour, fire, weapon = rng.choice((1, 2)), rng.choice(FIRES), rng.choice(WEAPONS)
        motion, button, pay = rng.choice(MOTIONS), rng.choice(BUTTONS), rng.choice(PAY)
        # Enemies that stay away would be no danger.
        fire = "straight" if enemies in ("patrol", "giant") and fire == "none" else fire
        # Raiders that come straight on are soon there, and leave no time to give way.
        armour = 1 if enemies == "rain" else armour
        fire = "straight" if enemies == "rain" and fire == "aimed" else fire
        return cls(difficulty, look, side, enemies, armour, fire, weapon, motion, button, pay)

    @property
    def title(self) -> str:
        place = {"bottom": "from below", "top": "from above", "left": "from the left", "right": "from the right"}
        return f"Shooting at {_NAMES[self.enemies]} {place[self.side]}"

    @property
    def kills(self) -> int:
        """The kills that the goal takes."""
        return 1 if self.enemies == "giant" else round(between(2, 14, self.difficulty))

    @property
    def hits(self) -> int:
        """The hits that an enemy takes."""
        return self.armour * round(between(3, 14, self.difficulty)) if self.enemies == "giant" else self.armour

    def write_rules(self, code: SourceBuilder) -> None:
        damage = 2 if self.weapon == "heavy" else 1
        shots = self.kills * -(-self.hits // damage)
        ammunition = round(shots * (1.25 + 3.5 * (1 - self.difficulty) ** 4)) + 1
        size = 16 if self.enemies == "giant" else 6
        code.add("constants", "# In pixels, as seen with the ship at the bottom.")
        code.add("constants", f"SHIP, FLOOR, CEILING, ENEMY = 7, 74, 6, {size}")
        code.add("constants", "# In pixels per step.", "SPEED, BULLET_SPEED, SHOT_SPEED = 3, 4, 2")
        code.add("constants", f"LIVES, WANTED, HITS, DAMAGE = 3, {self.kills}, {self.hits}, {damage}")
        rest = {"single": 6, "twin": 9, "heavy": 12}[self.weapon]
        code.add("constants", f"AMMUNITION, REST = {ammunition}, {rest}", "PRIZE, PENALTY = 5.0, 2.0")
        code.add("story", f"A ship at the {self.side} shoots. {_STORY[self.enemies]}")
        hits = -(-self.hits // damage)
        code.add("story", f"An enemy takes {hits} hits." if hits > 1 else "One hit destroys an enemy.")
        if self.enemies in ("rain", "weave"):
            code.add("constants", f"COME_EVERY = {16 + 12 * hits}")
        code.add("story", "An enemy that comes past the ship costs one of three lives.")
        code.add("story", f"The ship has {ammunition} shots, which the bar behind it shows.")
        code.add("reset", "self.lives, self.kills, self.ammunition, self.rest = LIVES, 0, AMMUNITION, 0")
        code.add("reset", "self.ship, self.drift = (SIZE - SHIP) // 2, 0", "self.bullets: list[list[int]] = []")
        code.add("reset", "# Enemies as x, y, hits left and direction; shots as x, y and speed to the side.")
        code.add("reset", "self.enemies: list[list[int]] = []", "self.shots: list[list[int]] = []")
        self._write_ship(code)
        code.add("advance", ADVANCE)
        code.add("methods", FLY)
        barrels = {"twin": "[self.ship, FLOOR - 3], [self.ship + SHIP - 2, FLOOR - 3]"}
        code.add("barrels", barrels.get(self.weapon, "[self.ship + SHIP // 2, FLOOR - 3]"))
        if self.weapon == "twin":
            code.add("story", "Each shot is two bullets, side by side.")
        code.add("methods", BRING)
        code.add("brought", *MOVES[self.enemies])
        if self.fire != "none":
            period = round(between(36, 22, self.difficulty))
            aim = "straight on" if self.fire == "straight" else "at the ship"
            code.add("story", f"Every {period} steps an enemy fires {aim}; a hit costs a life.")
            code.add("constants", f"FIRE_EVERY = {period}")
            code.add("advance", "self._fire()")
            code.add("methods", FIRE)
            aimed = "max(-1, min(1, (self.ship - enemy[0]) // 12))"
            code.add("course", aimed if self.fire == "aimed" else "0")
            code.add("draw_fire", "frame[83, 2 * (self.steps % FIRE_EVERY)] = SHOT")
        code.add(
            "advance",
            """
            if self.lives <= 0 or (self.ammunition == 0 and not self.bullets and not self.won):
                self.lost = True
            """,
        )
        self._write_goal(code)
        self._write_look(code)
        code.add("info", '"kills": self.kills, "lives": self.lives')
        code.add("state", '"ship": self.ship, "drift": self.drift, "rest": self.rest, "ammunition": self.ammunition,')
        code.add("state", '"enemies": [row[:] for row in self.enemies], "shots": [row[:] for row in self.shots],')
        code.add("state", '"bullets": [row[:] for row in self.bullets], "lives": self.lives,')

    def _write_ship(self, code: SourceBuilder) -> None:
        level = self.side in ("bottom", "top")
        back, forth = ("left", "right") if level else ("up", "down")
        code.add("constants", f"LESS, MORE = {'3, 4' if level else '1, 2'}")
        code.add("controls", f"{back.capitalize()} and {forth} move the ship. The first button shoots.")
        speed = "SPEED"
        if self.button == "dash":
            code.add("controls", "With the second button the ship is twice as fast.")
            speed = "(2 * SPEED if second else SPEED)"
        elif self.button == "brake":
            code.add("controls", "With the second button the ship moves by single pixels.")
            speed = "(1 if second else SPEED)"
        code.add("advance", f"wanted = ((direction == MORE) - (direction == LESS)) * {speed}")
        if self.motion == "gliding":
            code.add("story", "The ship glides: its speed changes by 1 at a step.")
            code.add("advance", "self.drift += (wanted > self.drift) - (wanted < self.drift)")
        else:
            code.add("advance", "self.drift = wanted")
        code.add("advance", "self.ship = max(0, min(SIZE - SHIP, self.ship + self.drift))")

    def _write_goal(self, code: SourceBuilder) -> None:
        aim = "Destroy the giant" if self.enemies == "giant" else f"Shoot down {self.kills} enemies"
        code.add("aim", f"{aim} before the lives or the shots are used up.")
        if self.pay != "goal":
            code.add("paid", "+1 for each kill")
            code.add("killed", "self.reward += 1.0")
            code.add("paid", "+0.1 for each hit")
            code.add("struck", "self.reward += 0.1")
        if self.pay == "thrift":
            code.add("paid", "-0.05 for each shot")
            code.add("shot", "self.reward -= 0.05")
        code.add("paid", "+5 for the goal", "-2 for losing")

    def _write_look(self, code: SourceBuilder) -> None:
        self.look.write_colours(code, ["SHIP_COLOUR", "ENEMY_COLOUR", "BULLET", "SHOT", "BAR"])
        self.look.write_tile(code)
        code.add("tiles", "SHIP_TILE, ENEMY_TILE = tile(SHIP_COLOUR, 5, SHIP), tile(ENEMY_COLOUR, 5, ENEMY)")
        code.add("tiles", "BACKDROP = np.full((SIZE, SIZE, 3), GROUND)", "BACKDROP[:CEILING] = PAGE")
        code.add("draw", DRAW)
        if SIDES[self.side]:
            code.add("draw", SIDES[self.side])
