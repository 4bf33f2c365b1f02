"""Twists: a rule or a place that most games have beside their goal and their danger."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from envcraft_composer.mechanic import Constants, Mechanic, scaled, traits

_PORTALS = """
# The avatar leaves by the other gate, and must step off it before it can return.
gate = next((number for number, place in enumerate(self.gates) if self.near(place, self.at)), -1)
if gate >= 0 and not self.inside:
    self.at = self.gates[1 - gate]
self.inside = gate >= 0
"""
_WIND = """
if self.clock % CYCLE == 0:
    self.at = self._shift(self.at, self.wind)
    self.wind = int(self.np_random.integers(1, 5))
"""
_DRAW_WIND = """
y, x = 42 + 36 * MOVES[self.wind][0], 42 + 40 * MOVES[self.wind][1]
frame[y - 1 : y + 1, x - 5 : x + 5 : 2] = frame[y - 5 : y + 5 : 2, x - 1 : x + 1] = PALETTE[7]
"""
_MIRRORS = """
if self.clock // CYCLE % 2:
    move = BACK[move]
"""
_DRAW_MIRRORS = """
if (self.clock + 1) // CYCLE % 2:
    frame[5:80:2, :2] = frame[5:80:2, -2:] = PALETTE[6]
"""
_MUD = """
if self.clock % 3 and any(self.near(place, self.at) for place in self.mud):
    move = 0
"""
_DRAW_MUD = """
for top, left in map(self._pixel, self.mud):
    frame[top + 1 : top + CELL : 2, left : left + CELL] = PALETTE[2]
"""
_BELTS = """
way = self.belts.get(self.at, 0)
if way and self.clock % 2:
    self.at = self._shift(self.at, way)
"""
_DRAW_BELTS = """
for (y, x), way in self.belts.items():
    self._blit(frame, (y, x), BELT, PALETTE[2])
    top, left = (side + CELL // 2 + 2 * part for side, part in zip(self._pixel((y, x)), MOVES[way]))
    frame[top : top + 2, left : left + 2] = PALETTE[7]
"""
_DOORS = """
if self.clock % CYCLE == 0:
    self.walls = self.walls ^ self.doors
"""
_DRAW_DOORS = """
for place in self.doors:
    self._blit(frame, place, SHUTTER, PALETTE[2] if place in self.walls else PALETTE[1])
"""
_STORM = """
if self.clock % CYCLE == 0:
    if self.near(self.strike, self.at):
        self._harm()
    self.strike = self.at
"""
_ECHO = """
self.past = [*self.past[1:], self.at]
if self.past[0] != self.past[1] and self.near(self.past[1], self.at):
    self._harm()
"""
_NIGHT = """
top, left = self._pixel(self.at)
lit = slice(max(top - LIGHT, 5), min(top + CELL + LIGHT, 80)), slice(max(left - LIGHT, 0), left + CELL + LIGHT)
seen = frame[lit].copy()
frame[5:80] //= 3
frame[lit] = seen
"""
_CLOUDS = """
for number in range(CLOUDS):
    top, left = 8 + 66 * number // CLOUDS, (41 * number + self.clock // 2) % 104 - 20
    frame[top : top + 8, max(left, 0) : max(left + 20, 0)] = PALETTE[1]
"""
_NETTLES = """
rest = [place for place in self.nettles if not self.near(place, self.at)]
self.reward -= STING * (len(self.nettles) - len(rest))
self.nettles = rest
"""
_SPRINGS = """
if move and any(self.near(place, self.at) for place in self.springs):
    for _ in range(THROW):
        self.at = self._shift(self.at, move)
"""
_TIDE = """
depth = abs(self.clock // EBB % (2 * HIGH) - HIGH)
if self.clock % 2 and self.at[0] >= ROWS - depth:
    move = 0
"""
_DRAW_TIDE = """
depth = abs((self.clock + 1) // EBB % (2 * HIGH) - HIGH)
bottom = TOP + CELL * ROWS
frame[bottom - CELL * depth : bottom : 3, LEFT : LEFT + CELL * COLUMNS] = PALETTE[7]
"""
_MAGNET = """
if self.clock % CYCLE == 0:
    dy, dx = self.magnet[0] - self.at[0], self.magnet[1] - self.at[1]
    pull = (2 if dy > 0 else 1) if abs(dy) > abs(dx) else (4 if dx > 0 else 3)
    self.at = self._shift(self.at, pull if dy or dx else 0)
"""
_SINKING = """
if self.clock % CYCLE == 0 and max((place[0] for place in self.gems), default=LOW) < LOW:
    self.gems = [(y + 1.0, x) for y, x in self.gems]
"""
_MARCHING = """
if self.clock % CYCLE == 0:
    self.gems = [(y, 1 + (x + (1 if number % 2 else -1) - 1) % (82 - CELL)) for number, (y, x) in enumerate(self.gems)]
"""
#: A bar at the left edge that is full when the next turn of a cycle comes.
_DRAW_CYCLE = """
frame[80 - 75 * (self.clock % CYCLE) // CYCLE : 80, :2] = PALETTE[7]
"""


def _constants(**ends: tuple[int, int]) -> Callable[[Random, float], Constants]:
    """Draw whole constants between two ends."""
    return lambda rng, level: {name: rng.randint(*pair) for name, pair in ends.items()}


def _more(name: str, low: int, high: int) -> Callable[[Random, float], Constants]:
    """A number of things by the level."""
    return lambda rng, level: {name: scaled(low, high, level) + rng.randint(0, 1)}


def _nettles(rng: Random, level: float) -> Constants:
    return {"NETTLES": scaled(5, 9, level) + rng.randint(0, 1), "STING": round(rng.uniform(0.1, 0.4), 2)}


TWISTS = (
    Mechanic("plain", ""),
    Mechanic(
        "portals",
        "Two gates lead to each other.",
        needs=traits("mover"),
        bars=traits("ball", "long", "heavy"),
        parts={
            "place": "self.gates, self.inside = self._spots(2), False",
            "stir": _PORTALS,
            "draw": "for place in self.gates:\n    self._blit(frame, place, GATE, PALETTE[7])",
        },
        sprites=("GATE",),
        shapes={
            "GATE": (
                "01110 10001 10001 10001 01110",
                "11111 10001 10101 10001 11111",
                "01010 10001 00000 10001 01010",
            )
        },
    ),
    Mechanic(
        "wind",
        "In every {CYCLE}th step a gust blows the avatar a step towards the cross, then the wind turns.",
        needs=traits("mover"),
        bars=traits("ball", "long", "heavy"),
        parts={
            "place": "self.wind = int(self.np_random.integers(1, 5))",
            "stir": _WIND,
            "hud": _DRAW_WIND + _DRAW_CYCLE.strip(),
        },
        draw=_constants(CYCLE=(4, 7)),
        pace=1.1,
    ),
    Mechanic(
        "mirrors",
        "In every other {CYCLE} steps the moves work the other way about; the edges of the picture are then striped.",
        bars=traits("turns"),
        parts={"before": _MIRRORS, "hud": _DRAW_MIRRORS},
        draw=_constants(CYCLE=(9, 16)),
    ),
    Mechanic(
        "mud",
        "Mud holds the avatar: there only one step in three obeys a move.",
        needs=traits("mover"),
        bars=traits("ball", "runs", "slides", "drifts"),
        parts={"place": "self.mud = self._spots(MUD)", "before": _MUD, "draw": _DRAW_MUD},
        draw=_more("MUD", 5, 9),
        pace=1.2,
    ),
    Mechanic(
        "belts",
        "Belts carry the avatar the way of their dot, in every other step.",
        needs=traits("mover", "cells"),
        bars=traits("long"),
        parts={
            "place": "self.belts = {place: int(self.np_random.integers(1, 5)) for place in self._spots(BELTS)}",
            "stir": _BELTS,
            "draw": _DRAW_BELTS,
        },
        sprites=("BELT",),
        shapes={
            "BELT": (
                "10101 01010 10101 01010 10101",
                "11111 00000 11111 00000 11111",
                "10101 10101 10101 10101 10101",
            )
        },
        draw=_more("BELTS", 5, 9),
        pace=1.1,
    ),
    Mechanic(
        "doors",
        "Every {CYCLE} steps the shutters close, or open again. A closed one is a wall.",
        needs=traits("mover", "walk"),
        # A thing that appears later would have to appear behind a closed shutter.
        bars=traits("heavy", "respawns"),
        parts={
            "place": "self.doors = set(self._spots(DOORS))",
            "before": _DOORS,
            "draw": _DRAW_DOORS,
            "hud": _DRAW_CYCLE,
        },
        sprites=("SHUTTER",),
        shapes={
            "SHUTTER": (
                "10101 11111 10101 11111 10101",
                "11111 11011 11011 11011 11111",
                "11111 00000 11111 00000 11111",
            )
        },
        draw=lambda rng, level: {"DOORS": scaled(3, 6, level), "CYCLE": rng.randint(5, 9)},
        pace=1.1,
    ),
    Mechanic(
        "storm",
        "In every {CYCLE}th step lightning strikes where the avatar was {CYCLE} steps before.",
        gives=traits("danger"),
        needs=traits("mover"),
        bars=traits("ball"),
        parts={
            "place": "self.strike = self._spots(1)[0]",
            "stir": _STORM,
            "draw": "self._blit(frame, self.strike, BOLT, PALETTE[6])",
            "hud": _DRAW_CYCLE,
        },
        sprites=("BOLT",),
        shapes={
            "BOLT": (
                "00110 01100 11111 00110 01100",
                "10001 01010 00100 01010 10001",
                "00010 00110 01110 01100 01000",
            )
        },
        draw=_constants(CYCLE=(5, 10)),
    ),
    Mechanic(
        "echo",
        "An echo of the avatar repeats its steps {DELAY} steps later. To be met by it is an accident.",
        gives=traits("danger"),
        needs=traits("mover"),
        # In a narrow world there is no way round the echo.
        bars=traits("ball", "long", "slides", "narrow", "side"),
        parts={
            "avatar": "self.past = [self.at] * (DELAY + 2)",
            "stir": _ECHO,
            "draw": "self._blit(frame, self.past[1], HERO, PALETTE[6])",
        },
        draw=_constants(DELAY=(6, 14)),
    ),
    Mechanic(
        "night",
        "It is night: what is more than {LIGHT} pixels away from the avatar is dark.",
        parts={"over": _NIGHT},
        draw=lambda rng, level: {"LIGHT": scaled(26, 16, level) + rng.randint(0, 6)},
    ),
    Mechanic(
        "clouds",
        "{CLOUDS} clouds drift over the world and hide what is below.",
        parts={"draw": _CLOUDS},
        draw=_more("CLOUDS", 3, 5),
    ),
    Mechanic(
        "nettles",
        "{NETTLES} nettles sting once each, for a reward of -{STING}.",
        needs=traits("mover"),
        bars=traits("ball"),
        parts={
            "place": "self.nettles = self._spots(NETTLES)",
            "touch": _NETTLES,
            "draw": "for place in self.nettles:\n    self._blit(frame, place, NETTLE, PALETTE[6])",
        },
        sprites=("NETTLE",),
        shapes={
            "NETTLE": (
                "00000 01010 00100 10101 01110",
                "00100 10101 01110 00100 00100",
                "10001 01010 00000 01010 10001",
            )
        },
        draw=_nettles,
    ),
    Mechanic(
        "springs",
        "A move on a spring throws the avatar {THROW} steps further.",
        needs=traits("mover"),
        bars=traits("ball", "long", "slides", "drifts", "turns", "runs", "points"),
        parts={
            "place": "self.springs = self._spots(SPRINGS)",
            "stir": _SPRINGS,
            "draw": "for place in self.springs:\n    self._blit(frame, place, SPRING, PALETTE[7])",
        },
        sprites=("SPRING",),
        shapes={
            "SPRING": (
                "11111 00100 01010 00100 11111",
                "00100 01110 10101 00100 00100",
                "11111 01010 00100 01010 11111",
            )
        },
        draw=lambda rng, level: {"SPRINGS": scaled(4, 7, level), "THROW": rng.randint(1, 3)},
    ),
    Mechanic(
        "tide",
        "The tide comes and goes from below, as far as {HIGH} rows. In the water only every other step obeys a move.",
        needs=traits("mover", "cells"),
        bars=traits("wrap", "runs", "slides"),
        parts={"before": _TIDE, "over": _DRAW_TIDE},
        draw=lambda rng, level: {"HIGH": scaled(3, 5, level) + rng.randint(0, 2), "EBB": rng.randint(4, 8)},
        pace=1.2,
    ),
    Mechanic(
        "magnet",
        "In every {CYCLE}th step a magnet pulls the avatar a step towards itself.",
        needs=traits("mover"),
        bars=traits("ball", "long", "heavy"),
        parts={
            "place": "self.magnet = self._spots(1)[0]",
            "stir": _MAGNET,
            "draw": "self._blit(frame, self.magnet, MAGNET, PALETTE[7])",
            "hud": _DRAW_CYCLE,
        },
        sprites=("MAGNET",),
        shapes={
            "MAGNET": (
                "11011 11011 10001 11011 01110",
                "01110 11011 10001 11011 11011",
                "11111 11000 10000 11000 11111",
            )
        },
        draw=_constants(CYCLE=(3, 6)),
        pace=1.1,
    ),
    Mechanic(
        "sinking",
        "All bricks sink by a pixel in every {CYCLE}th step, until one is low.",
        needs=traits("ball"),
        parts={"stir": _SINKING},
        draw=_constants(CYCLE=(6, 12)),
    ),
    Mechanic(
        "marching",
        "In every {CYCLE}th step every other brick moves to the right, the rest to the left.",
        needs=traits("ball"),
        parts={"stir": _MARCHING},
        draw=_constants(CYCLE=(2, 5)),
    ),
)
