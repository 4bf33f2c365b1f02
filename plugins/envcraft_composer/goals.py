"""Goals: what wins. Each defines ``_remaining`` (0 is a win) and ``_targets`` (the places that count now)."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from envcraft_composer.mechanic import Constants, Mechanic, goal_methods, scaled, traits


def _count(low: int, high: int, **more: tuple[int, int]) -> Callable[[Random, float], Constants]:
    """Draw the number of things by the level, and further constants."""

    def draw(rng: Random, level: float) -> Constants:
        return {
            "COUNT": scaled(low, high, level) + rng.randint(0, 1),
            **{name: rng.randint(*ends) for name, ends in more.items()},
        }

    return draw


_COLLECT = """
self.gems = [place for place in self.gems if not self.near(place, self.at)]
"""
_ORDER = """
if self.done < COUNT and self.near(self.beacons[self.done], self.at):
    self.done += 1
"""
_DRAW_ORDER = """
for number, place in enumerate(self.beacons[self.done :]):
    self._blit(frame, place, BEACON, PALETTE[4] if number == 0 else PALETTE[5])
    top, left = self._pixel(place)
    frame[top, left : left + min(number, CELL)] = PALETTE[7]
"""
_UNLOCK = """
self.keys = [place for place in self.keys if not self.near(place, self.at)]
self.out = self.out or (not self.keys and self.near(self.exit, self.at))
"""
_DRAW_UNLOCK = """
self._blit(frame, self.exit, DOOR, PALETTE[5] if self.keys else PALETTE[4])
for place in self.keys:
    self._blit(frame, place, KEY, PALETTE[4])
"""
_SWITCH = """
here = [number for number, place in enumerate(self.switches) if self.near(place, self.at)]
if here and here[0] != self.standing:
    self.lit[here[0]] = not self.lit[here[0]]
self.standing = here[0] if here else -1
"""
_DRAW_SWITCH = """
for place, lit in zip(self.switches, self.lit, strict=True):
    self._blit(frame, place, SWITCH, PALETTE[4] if lit else PALETTE[5])
"""
_DELIVER = """
if self.carries and self.near(self.depot, self.at):
    self.carries = False
elif not self.carries:
    found = next((place for place in self.items if self.near(place, self.at)), None)
    if found is not None:
        self.items.remove(found)
        self.carries = True
"""
_DRAW_DELIVER = """
self._blit(frame, self.depot, DEPOT, PALETTE[5])
for place in self.items:
    self._blit(frame, place, PARCEL, PALETTE[4])
"""
_DRAW_CARRIED = """
if self.carries:
    top, left = self._pixel(self.at)
    frame[top : top + CELL // 2, left + CELL // 4 : left + CELL // 4 + CELL // 2] = PALETTE[4]
"""
_TRAMPLE = """
if self.at in self.bare:
    self.bare.discard(self.at)
    self._stain(self.at)
"""
_STAIN = '''
    def _stain(self, place: tuple[int, int]) -> None:
        """Colour a cell for good."""
        top, left = self._pixel(place)
        self.picture[top : top + CELL, left : left + CELL] = PALETTE[5]
'''
_ESCORT = """
joined = [place for place in self.waiting if self.near(place, self.at)]
self.waiting = [place for place in self.waiting if place not in joined]
self.train = [] if self.near(self.home, self.at) else self.train + joined
"""
_TRAIL = """
if self.at != self.trail[0]:
    self.trail = [self.at, *self.trail][: PACE * (len(self.train) + 1)]
last = len(self.trail) - 1
self.train = [self.trail[min(PACE * number, last)] for number in range(1, len(self.train) + 1)]
"""
_DRAW_ESCORT = """
self._blit(frame, self.home, DEPOT, PALETTE[5])
for place in [*self.waiting, *self.train]:
    self._blit(frame, place, CHICK, PALETTE[4])
"""
_CATCH = """
self.sheep = [place for place in self.sheep if not self.near(place, self.at)]
"""
_FLEE = """
if self.clock % FLEE == 0:
    herd = []
    for place in self.sheep:
        ways = [self._shift(place, move) for move in range(1, 5)]
        ways = [way for way in ways if way not in self.sheep and way not in herd] + [place]
        herd.append(max(ways, key=lambda way: abs(way[0] - self.at[0]) + abs(way[1] - self.at[1])))
    self.sheep = herd
"""
_SHOOT = """
for place in self.beam:
    hit = next((target for target in self.marks if self.near(target, place)), None)
    if hit is not None:
        self.marks.remove(hit)
        break
    if any(self.near(friend, place) for friend in self.friends):
        self.beam = []
        self._harm()
        break
"""
_DRAW_SHOOT = """
for place in self.marks:
    self._blit(frame, place, MARK, PALETTE[4])
for place in self.friends:
    self._blit(frame, place, FRIEND, PALETTE[5])
"""
_SCORE = """
if self.near(self.prize, self.at):
    self.score += 1
    self.taken = type(self.taken)([self.at])
    self.prize = self._spots(1)[0]
"""
_PUSH = '''
    def _push(self, move: int) -> tuple[int, int]:
        """The avatar's cell after a step, which pushes a crate if there is room behind it."""
        after = self._shift(self.at, move)
        if after in self.crates:
            beyond = self._shift(after, move)
            if beyond == after or beyond in self.crates:
                return self.at
            self.crates = [beyond if crate == after else crate for crate in self.crates]
        return after
'''
_PUSH_PLACE = """
# The crates start on their marks and are pulled away, so that they can be pushed back.
for _ in range(500):
    self.taken = {self.at}
    self.marks = self._spots(COUNT)
    self.crates = self._pulled(list(self.marks))
    if not set(self.crates) & set(self.marks) and self._open(self.crates):
        break
"""
_PULLED = '''
    def _pulled(self, parts: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Where these things are after some pulls, each of which a push undoes."""
        for _ in range(PULLS):
            number, move = self.np_random.integers((0, 1), (len(parts), 5)).tolist()
            for _ in range(self.np_random.integers(1, 4)):
                stand = self._shift(parts[number], move)
                behind = self._shift(stand, move)
                if stand == parts[number] or behind == stand or {stand, behind} & set(parts):
                    break
                parts[number] = stand
        return parts
'''
_OPEN = '''
    def _open(self, parts: list[tuple[int, int]]) -> bool:
        """Whether the avatar, which starts outside, can walk to all free cells beside these things."""
        walls, self.walls = self.walls, self.walls | set(parts)
        found = set(self._reachable())
        self.walls = walls
        beside = {self._shift(part, move) for part in parts for move in range(1, 5)} - set(parts)
        return self.at not in parts and beside <= found
'''
#: Methods of goals that start with things that are pulled apart.
PULLING = {"method:pulled": _PULLED, "method:open": _OPEN}
_DRAW_PUSH = """
for place in self.marks:
    self._blit(frame, place, RING, PALETTE[4])
for place in self.crates:
    self._blit(frame, place, CRATE, PALETTE[4] if place in self.marks else PALETTE[5])
"""
_EXPLORE = """
for y in range(self.at[0] - SIGHT, self.at[0] + SIGHT + 1):
    for x in range(self.at[1] - SIGHT, self.at[1] + SIGHT + 1):
        self.hidden.discard((y, x))
"""
_DRAW_FOG = """
for place in self.hidden:
    top, left = self._pixel(place)
    frame[top : top + CELL, left : left + CELL] = PALETTE[5]
"""

GOALS = (
    Mechanic(
        "collect",
        "Goal: collect all {COUNT} gems.",
        needs=traits("mover"),
        bars=traits("ball"),
        parts={
            "place": "self.gems = self._spots(COUNT)",
            "touch": _COLLECT,
            "draw": "for place in self.gems:\n    self._blit(frame, place, GEM, PALETTE[4])",
            **goal_methods("len(self.gems)", "self.gems"),
        },
        sprites=("GEM",),
        draw=_count(2, 14),
    ),
    Mechanic(
        "bricks",
        "Goal: hit all {COUNT} bricks with the ball.",
        needs=traits("ball"),
        parts={
            "place": "self.gems = self._spots(COUNT)",
            "touch": _COLLECT,
            "draw": "for place in self.gems:\n    self._blit(frame, place, CRATE, PALETTE[4])",
            **goal_methods("len(self.gems)", "self.gems"),
        },
        sprites=("CRATE",),
        draw=_count(6, 14),
    ),
    Mechanic(
        "order",
        "Goal: touch the {COUNT} beacons in order. The next one is bright; lines number the others.",
        needs=traits("mover"),
        bars=traits("ball"),
        parts={
            "place": "self.beacons, self.done = self._spots(COUNT), 0",
            "touch": _ORDER,
            "draw": _DRAW_ORDER,
            **goal_methods("COUNT - self.done", "self.beacons[self.done : self.done + 1]"),
        },
        sprites=("BEACON",),
        draw=_count(2, 8),
        pace=1.5,
    ),
    Mechanic(
        "unlock",
        "Goal: take all {COUNT} keys, then leave through the door, which is bright once it is open.",
        needs=traits("mover"),
        bars=traits("ball", "long"),
        parts={
            "place": "*self.keys, self.exit = self._spots(COUNT + 1)\nself.out = False",
            "touch": _UNLOCK,
            "draw": _DRAW_UNLOCK,
            **goal_methods("len(self.keys) + (not self.out)", "self.keys or [self.exit]"),
        },
        sprites=("KEY", "DOOR"),
        draw=_count(1, 9),
    ),
    Mechanic(
        "switches",
        "Goal: turn on all {COUNT} switches. Stepping on a switch turns it on, or off again.",
        needs=traits("mover"),
        # In a narrow world the way to one switch would lead over others.
        bars=traits("ball", "long", "slides", "narrow"),
        parts={
            "place": "self.switches, self.standing = self._spots(COUNT), -1\nself.lit = [False] * COUNT",
            "touch": _SWITCH,
            "draw": _DRAW_SWITCH,
            **goal_methods(
                "self.lit.count(False)", "[place for place, lit in zip(self.switches, self.lit) if not lit]"
            ),
        },
        sprites=("SWITCH",),
        draw=_count(2, 10),
    ),
    Mechanic(
        "deliver",
        "Goal: bring all {COUNT} parcels to the depot, one at a time.",
        needs=traits("mover"),
        bars=traits("ball", "long"),
        parts={
            "place": "self.depot, *self.items = self._spots(COUNT + 1)\nself.carries = False",
            "touch": _DELIVER,
            "draw": _DRAW_DELIVER,
            "over": _DRAW_CARRIED,
            **goal_methods("2 * len(self.items) + self.carries", "[self.depot] if self.carries else self.items"),
        },
        sprites=("PARCEL", "DEPOT"),
        draw=_count(1, 6),
        pace=2.0,
    ),
    Mechanic(
        "trample",
        "Goal: tread on every cell that can be reached.",
        needs=traits("mover", "walk"),
        bars=traits("ball", "long", "traffic"),
        parts={
            "place": "self.bare = set(self._reachable()) - {self.at}",
            "touch": _TRAMPLE,
            "method:stain": _STAIN,
            **goal_methods("len(self.bare)", "list(self.bare)"),
        },
        area=1.5,
    ),
    Mechanic(
        "escort",
        "Goal: fetch all {COUNT} chicks, which follow in a train, and lead them home.",
        needs=traits("mover"),
        bars=traits("ball", "long", "slides"),
        parts={
            "place": "self.home, *self.waiting = self._spots(COUNT + 1)\nself.train, self.trail = [], [self.at]",
            "touch": _ESCORT,
            "stir": _TRAIL,
            "draw": _DRAW_ESCORT,
            **goal_methods("2 * len(self.waiting) + len(self.train)", "self.waiting or [self.home]"),
        },
        sprites=("CHICK", "DEPOT"),
        draw=_count(1, 8),
        pace=1.2,
    ),
    Mechanic(
        "catch",
        "Goal: catch all {COUNT} sheep. They flee one step in every {FLEE}.",
        needs=traits("mover", "walk"),
        bars=traits("ball", "long", "slides"),
        parts={
            "place": "self.sheep = self._spots(COUNT)",
            "touch": _CATCH,
            "stir": _FLEE,
            "draw": "for place in self.sheep:\n    self._blit(frame, place, SHEEP, PALETTE[4])",
            **goal_methods("len(self.sheep)", "self.sheep"),
        },
        sprites=("SHEEP",),
        draw=_count(2, 8, FLEE=(3, 4)),
        pace=1.8,
    ),
    Mechanic(
        "shoot",
        "Goal: shoot all {COUNT} marks. To hit one of the {FRIENDS} friends is an accident.",
        needs=traits("aims"),
        parts={
            "place": "self.marks, self.friends = self._spots(COUNT), self._spots(FRIENDS)",
            "stir": _SHOOT,
            "draw": _DRAW_SHOOT,
            **goal_methods("len(self.marks)", "self.marks"),
        },
        sprites=("MARK", "FRIEND"),
        draw=_count(3, 9, FRIENDS=(3, 5)),
        gives=traits("danger"),
        pace=1.2,
    ),
    Mechanic(
        "score",
        "Goal: take {COUNT} fruits before time is up. Each fruit appears when the last one is taken.",
        gives=traits("respawns"),
        needs=traits("mover"),
        bars=traits("ball"),
        parts={
            "place": "self.prize, self.score = self._spots(1)[0], 0",
            "touch": _SCORE,
            "draw": "self._blit(frame, self.prize, FRUIT, PALETTE[4])",
            **goal_methods("COUNT - self.score", "[self.prize]"),
        },
        sprites=("FRUIT",),
        draw=_count(2, 14),
        pace=1.5,
    ),
    Mechanic(
        "crates",
        "Goal: push all {COUNT} crates onto the marks. A crate cannot be pulled.",
        gives=traits("heavy"),
        needs=traits("roomy", "pushes"),
        bars=traits("danger"),
        parts={
            "method:push": _PUSH,
            "place": _PUSH_PLACE,
            **PULLING,
            "draw": _DRAW_PUSH,
            **goal_methods("sum(crate not in self.marks for crate in self.crates)", "self.marks"),
        },
        sprites=("CRATE", "RING"),
        draw=_count(2, 3, PULLS=(20, 40)),
        pace=8.0,
    ),
    Mechanic(
        "explore",
        "Goal: lift the fog from the whole world. The avatar sees {SIGHT} cells far.",
        needs=traits("mover", "cells"),
        bars=traits("ball", "long"),
        parts={
            "place": "self.hidden = set(self._reachable())",
            "touch": _EXPLORE,
            "draw": _DRAW_FOG,
            **goal_methods("len(self.hidden)", "list(self.hidden)"),
        },
        draw=lambda rng, level: {"SIGHT": 1},
        area=0.6,
    ),
)
