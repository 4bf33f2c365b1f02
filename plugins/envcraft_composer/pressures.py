"""Dangers and pressures: what hurts, and what an accident costs."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from envcraft_composer.mechanic import Constants, Mechanic, scaled, traits

_HURT = """
if any(self.near(foe[0], self.at) for foe in self.foes):
    self._harm()
"""
_PATROL = """
if self.clock % BEAT == 0:
    for foe in self.foes:
        after = self._shift(foe[0], foe[1])
        if after == foe[0]:
            foe[1] = BACK[foe[1]]
        foe[0] = after
"""
_WANDER = """
if self.clock % BEAT == 0:
    for foe in self.foes:
        if self.np_random.random() < 0.3 or self._shift(foe[0], foe[1]) == foe[0]:
            foe[1] = int(self.np_random.integers(1, 5))
        foe[0] = self._shift(foe[0], foe[1])
"""
_CHASE = """
if self.clock % BEAT == 0:
    for foe in self.foes:
        dy, dx = self.at[0] - foe[0][0], self.at[1] - foe[0][1]
        ways = sorted([(abs(dy), 2 if dy > 0 else 1), (abs(dx), 4 if dx > 0 else 3)], reverse=True)
        found = [[self._shift(foe[0], way), way] for _, way in ways]
        foe[:] = next((step for step in found if step[0] != foe[0]), foe)
"""
_PLACE_FOES = """
self.foes = [[place, int(self.np_random.integers(1, 5))] for place in self._spots(FOES)]
"""
_DRAW_FOES = """
for place, way in self.foes:
    self._blit(frame, place, FOE, PALETTE[6])
    y, x = (side + CELL // 2 * (1 + part) for side, part in zip(self._pixel(place), MOVES[way]))
    frame[y, x] = PALETTE[7]
"""
_DRAW_BEAT = """
frame[1:4, 66 : 67 + self.clock % BEAT] = PALETTE[6]
"""
_FIRE = """
if self.clock % SPREAD == 0:
    edge = [self._shift(place, move) for place in self.fire for move in range(1, 5)]
    edge = [place for place in edge if place not in self.fire and place not in self._targets()]
    if edge:
        # The oldest flame goes out, so that no way stays barred.
        self.fire = [*self.fire, edge[self.np_random.integers(len(edge))]][-FIRES:]
"""
_HURT_FIRE = """
if self.at in self.fire:
    self._harm()
"""
_SPIKES = """
if any(self.near(place, self.at) for place in self.spikes) and self.clock % PERIOD >= PERIOD // 2:
    self._harm()
"""
_DRAW_SPIKES = """
out = self.clock % PERIOD >= PERIOD // 2
for place in self.spikes:
    self._blit(frame, place, SPIKE, PALETTE[6] if out else PALETTE[2])
frame[1:4, 66 : 67 + self.clock % PERIOD] = PALETTE[6]
"""


_LIVES = '''
    def _harm(self) -> None:
        """An accident costs a life. For some steps after it the avatar is safe, which a bar at the top shows."""
        if not self.shield:
            self.lives -= 1
            self.reward -= HARM
            self.shield = SHIELD
            self.lost = self.lives == 0
'''
_FRAIL = '''
    def _harm(self) -> None:
        """An accident loses the game, except in the first steps, which a bar at the top shows."""
        self.lost = self.lost or not self.shield
'''
_TIRE = '''
    def _harm(self) -> None:
        """An accident costs energy. For some steps after it the avatar is safe, which a bar at the top shows."""
        if not self.shield:
            self.energy -= HIT
            self.reward -= HARM
            self.shield = SHIELD
'''
_SHIELDED = """
if self.shield:
    self._blit(frame, self.at, HERO, PALETTE[7])
    frame[4, 47 : 47 + self.shield] = PALETTE[3]
"""
_RECOVER = """
self.shield = max(self.shield - 1, 0)
"""
_TIMED = """
self.lost = self.lost or self.clock >= TIME
"""
_CLOCK = """
frame[81:83, 1 : 1 + 82 * (TIME - self.clock) // TIME] = PALETTE[4]
"""
_BURN = """
gain = max(self.fewest - self._remaining(), 0) * TIME / 2 / self.total
self.energy = min(self.energy - 1 + gain, TIME / 2)
self.lost = self.lost or self.energy <= 0
"""


def _safe(rng: Random, level: float) -> Constants:
    """The steps at the start in which nothing harms, so that a player who looks first has not lost already."""
    return {"SAFE": 30 + rng.randint(0, 6)}


def _beat(low: int, high: int, slow: tuple[int, int], **more: tuple[int, int]) -> Callable[[Random, float], Constants]:
    """Draw the number of foes by the level, and how many steps they take for one of theirs."""

    def draw(rng: Random, level: float) -> Constants:
        return {
            "FOES": scaled(low, high, level),
            "BEAT": rng.randint(*slow),
            **{name: rng.randint(*ends) for name, ends in more.items()},
        }

    return draw


def _foes(name: str, about: str, stir: str, draw: Callable[[Random, float], Constants], bars: str = "") -> Mechanic:
    return Mechanic(
        name,
        about,
        gives=traits("danger", "foes"),
        needs=traits("mover"),
        bars=traits("ball", *bars.split()),
        parts={
            "place": _PLACE_FOES,
            "touch": _HURT,
            "stir": stir,
            "draw": _DRAW_FOES,
            "hud": _DRAW_BEAT,
        },
        sprites=("FOE",),
        draw=draw,
    )


DANGERS = (
    Mechanic("calm", ""),
    _foes(
        "patrols",
        "{FOES} guards walk to and fro, one step in every {BEAT}.",
        _PATROL,
        _beat(2, 6, (1, 2)),
    ),
    # In narrow worlds these would bar the only way for long.
    _foes("strays", "{FOES} beasts stray about, one step in every {BEAT}.", _WANDER, _beat(2, 5, (1, 3)), "narrow"),
    _foes(
        "hunters",
        "{FOES} hunters come straight for the avatar, one step in every {BEAT}.",
        _CHASE,
        _beat(1, 3, (3, 4)),
        "narrow",
    ),
    Mechanic(
        "fire",
        "A fire creeps through the world. It burns on up to {FIRES} cells.",
        gives=traits("danger", "foes"),
        needs=traits("mover", "open"),
        bars=traits("long"),
        parts={
            "place": "self.fire = self._spots(1)",
            "touch": _HURT_FIRE,
            "stir": _FIRE,
            "draw": "for place in self.fire:\n    self._blit(frame, place, FLAME, PALETTE[6])",
        },
        sprites=("FLAME",),
        draw=lambda rng, level: {"FIRES": scaled(6, 16, level), "SPREAD": rng.randint(4, 9)},
    ),
    Mechanic(
        "spikes",
        "{SPIKES} traps have their spikes out during the second half of every {PERIOD} steps.",
        gives=traits("danger", "foes"),
        needs=traits("mover"),
        bars=traits("ball"),
        parts={
            "place": "self.spikes = self._spots(SPIKES)",
            "touch": _SPIKES,
            "draw": _DRAW_SPIKES,
        },
        sprites=("SPIKE",),
        draw=lambda rng, level: {"SPIKES": scaled(3, 9, level), "PERIOD": 2 * rng.randint(2, 5)},
    ),
)

PRESSURES = (
    Mechanic(
        "hurry",
        "Time is up after {TIME} steps; the bar at the bottom shows the rest.",
        bars=traits("danger"),
        parts={"press": _TIMED, "hud": _CLOCK},
    ),
    Mechanic(
        "frail",
        "After the first {SAFE} steps an accident loses the game. So does the end of time, after {TIME} steps; the bar "
        "at the bottom shows it.",
        needs=traits("danger"),
        bars=traits("ball", "aims", "narrow"),
        parts={
            "avatar": "self.shield = SAFE",
            "method:harm": _FRAIL,
            "press": _RECOVER + _TIMED.strip(),
            "over": _SHIELDED,
            "hud": _CLOCK,
        },
        draw=_safe,
    ),
    Mechanic(
        "lives",
        "After the first {SAFE} steps the third accident loses the game, and so does the end of time, after {TIME} "
        "steps. The bar at the bottom shows the time, and the squares at the top show the lives.",
        needs=traits("danger"),
        parts={
            "avatar": "self.lives, self.shield = 3, SAFE",
            "method:harm": _LIVES,
            "press": _RECOVER + _TIMED.strip(),
            "over": _SHIELDED,
            "hud": _CLOCK
            + "for life in range(self.lives):\n    frame[1:4, 80 - 4 * life : 83 - 4 * life] = PALETTE[3]",
        },
        draw=lambda rng, level: {"SHIELD": rng.randint(6, 12), **_safe(rng, level)},
    ),
    Mechanic(
        "energy",
        "Every step costs energy, accidents after the first {SAFE} steps cost more, and progress restores some. "
        "Without energy the game is lost. The bar at the bottom shows what is left.",
        needs=traits("danger"),
        parts={
            "avatar": "self.energy, self.shield = TIME / 2, SAFE",
            "method:harm": _TIRE,
            "press": _RECOVER + _BURN.strip(),
            "over": _SHIELDED,
            "hud": "frame[81:83, 1 : 1 + max(round(164 * self.energy / TIME), 0)] = PALETTE[4]",
        },
        draw=lambda rng, level: {
            "SHIELD": rng.randint(6, 12),
            "HIT": scaled(15, 40, level),
            **_safe(rng, level),
        },
    ),
)
