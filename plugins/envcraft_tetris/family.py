"""The family `tetris`."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

from envcraft.families import Family, Generated

from .variant import Variant


class TetrisFamily(Family):
    name = "tetris"
    summary = "falling pieces: boards, pieces, controls, clearing, goals and looks drawn at random (contract arcade)"

    def generate(self, count: int, seed: int) -> Iterator[Generated]:
        rng = Random(seed)
        known: set[object] = set()
        while len(known) < count:
            variant = Variant.draw(rng)
            if variant.rules in known:
                continue
            number = len(known)
            known.add(variant.rules)
            source = variant.write(f"Tetris{number:04}")
            yield Generated(f"tetris_{seed}_{number:04}", source, {"axes": variant.axes()})
