"""The goal `merge`: drops that become one when they are pushed together."""

from __future__ import annotations

from envcraft_composer.mechanic import Mechanic, goal_methods, scaled, traits

GROUP = "goal"

_PUSH = """
after = self._shift(self.at, move)
beyond = self._shift(after, move)
if after not in self.drops:
    self.at = after
elif beyond != after:
    self.drops = self.drops - {after} | {beyond}
    self.at = after
"""
_PLACE = """
# The drops start as one and are pulled apart, so that they can be pushed together.
for _ in range(500):
    self.taken = {self.at}
    parts = self._spots(1) * COUNT
    for _ in range(PULLS):
        number, move = int(self.np_random.integers(1, COUNT)), int(self.np_random.integers(1, 5))
        for _ in range(int(self.np_random.integers(1, 4))):
            stand = self._shift(parts[number], move)
            behind = self._shift(stand, move)
            if stand == parts[number] or behind == stand or stand in parts or behind in parts:
                break
            parts[number] = stand
    self.drops = set(parts)
    if len(self.drops) == COUNT and self._open():
        break
"""
_OPEN = '''
    def _open(self) -> bool:
        """Whether the avatar, which starts outside, can walk to all free cells beside drops."""
        walls, self.walls = self.walls, self.walls | self.drops
        found = set(self._reachable())
        self.walls = walls
        beside = {self._shift(drop, move) for drop in self.drops for move in range(1, 5)} - self.drops
        return self.at not in self.drops and beside <= found
'''

MECHANIC = Mechanic(
    "merge",
    "Goal: push the {COUNT} drops together until they are one. A drop cannot be pulled.",
    needs=traits("roomy", "pushes"),
    bars=traits("traffic"),
    parts={
        "act": _PUSH,
        "place": _PLACE,
        "method:open": _OPEN,
        "draw": "for place in self.drops:\n    self._blit(frame, place, DROP, PALETTE[4])",
        **goal_methods("len(self.drops) - 1", "list(self.drops)"),
    },
    sprites=("DROP",),
    shapes={
        "DROP": (
            "00100 01110 11111 11101 01110",
            "01110 11111 10111 11111 01110",
            "00100 01110 11011 11111 01110",
        )
    },
    draw=lambda rng, level: {"COUNT": scaled(3, 4, level), "PULLS": rng.randint(20, 30)},
    pace=4.0,
)
