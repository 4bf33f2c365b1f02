"""The goal `merge`: drops that become one when they are pushed together."""

from __future__ import annotations

from envcraft_composer.goals import PULLING
from envcraft_composer.mechanic import Mechanic, goal_methods, scaled, traits

GROUP = "goal"

_PUSH = '''
    def _push(self, move: int) -> tuple[int, int]:
        """The avatar's cell after a step, which pushes a drop if there is no wall behind it."""
        after = self._shift(self.at, move)
        beyond = self._shift(after, move)
        if after not in self.drops:
            return after
        if beyond == after:
            return self.at
        self.drops = self.drops - {after} | {beyond}
        return after
'''
_PLACE = """
# The drops start as one and are pulled apart, so that they can be pushed together.
for _ in range(500):
    self.taken = {self.at}
    self.drops = set(self._pulled(self._spots(1) * COUNT))
    if len(self.drops) == COUNT and self._open(self.drops):
        break
"""

MECHANIC = Mechanic(
    "merge",
    "Goal: push the {COUNT} drops together until they are one. A drop cannot be pulled.",
    gives=traits("heavy"),
    needs=traits("roomy", "pushes"),
    bars=traits("traffic"),
    parts={
        "method:push": _PUSH,
        "place": _PLACE,
        **PULLING,
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
    draw=lambda rng, level: {"COUNT": scaled(2, 4, level), "PULLS": rng.randint(20, 30)},
    pace=4.0,
)
