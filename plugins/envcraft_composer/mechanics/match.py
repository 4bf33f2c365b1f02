"""The goal `match`: panels whose colours must match a pattern."""

from __future__ import annotations

from envcraft_composer.mechanic import Mechanic, goal_methods, scaled, traits

GROUP = "goal"

_PLACE = """
# Each panel shows one of three colours, and wants another.
self.panels, self.standing = self._spots(COUNT), -1
self.wants = self.np_random.integers(3, size=COUNT).tolist()
self.shown = [(want + int(self.np_random.integers(1, 3))) % 3 for want in self.wants]
"""
_TOUCH = """
here = next((number for number, place in enumerate(self.panels) if self.near(place, self.at)), -1)
if here not in (-1, self.standing):
    self.shown[here] = (self.shown[here] + 1) % 3
self.standing = here
"""
_DRAW = """
for place, shown, want in zip(self.panels, self.shown, self.wants, strict=True):
    self._blit(frame, place, PANEL, PALETTE[3 + shown])
    top, left = self._pixel(place)
    middle = slice(top + CELL // 2 - 1, top + CELL // 2 + 1), slice(left + CELL // 2 - 1, left + CELL // 2 + 1)
    frame[middle] = PALETTE[3 + want]
"""

MECHANIC = Mechanic(
    "match",
    "Goal: give all {COUNT} panels the colour of the dot in their middle. Each visit turns a panel to the next of "
    "three colours.",
    needs=traits("mover"),
    bars=traits("ball", "long", "slides", "narrow"),
    parts={
        "place": _PLACE,
        "touch": _TOUCH,
        "draw": _DRAW,
        **goal_methods(
            "sum((want - shown) % 3 for want, shown in zip(self.wants, self.shown))",
            "[place for place, want, shown in zip(self.panels, self.wants, self.shown) if want != shown]",
        ),
    },
    sprites=("PANEL",),
    shapes={
        "PANEL": (
            "11111 11111 11111 11111 11111",
            "01110 11111 11111 11111 01110",
            "11111 10101 11111 10101 11111",
        )
    },
    draw=lambda rng, level: {"COUNT": scaled(2, 7, level) + rng.randint(0, 1)},
    pace=1.8,
)
