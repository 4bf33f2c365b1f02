"""The family `tetris`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from random import Random
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.errors import UsageError
from envcraft.families import Family, Generated

from .axes.controls import Controls
from .variant import Variant

if TYPE_CHECKING:
    from .fastlane.simulator import Simulator


_DROPS = {"button": "a button drops pieces", "down": "down drops pieces", "none": "nothing drops pieces"}


class TetrisFamily(Family):
    name = "tetris"
    summary = "falling pieces: boards, pieces, controls, clearing, goals and looks drawn at random (contract arcade)"

    def generate(self, count: int, seed: int) -> Iterator[Generated]:
        rng = Random(seed)
        known: set[object] = set()
        # A number is that of a draw: a variant keeps it when one before it is found to be unfit.
        for number in itertools.count():
            if len(known) == count:
                return
            variant = Variant.draw(rng)
            if variant.rules in known or not variant.fair:
                continue
            known.add(variant.rules)
            source = variant.write(f"Tetris{number:04}")
            yield Generated(f"tetris_{seed}_{number:04}", source, {"axes": variant.axes()})

    def kind(self, metadata: dict[str, Any]) -> str:
        """What drops a piece at once: who leaves it alone plays longer."""
        return _DROPS[Controls(**metadata["axes"]["controls"]).drop] if "axes" in metadata else ""

    def simulate(self, generated: Sequence[Generated]) -> Simulator:
        from .fastlane.simulator import Simulator

        known: dict[str, Variant] = {}
        for one in generated:
            if one.source not in known:
                known[one.source] = variant_of(one)
        return Simulator([known[one.source] for one in generated])


def variant_of(generated: Generated) -> Variant:
    """The variant that a source was written for. Raises UsageError where it would be written otherwise."""
    try:
        variant = msgspec.convert(generated.metadata.get("axes"), Variant)
        class_name = re.search(r"^class (\w+)\(", generated.source, re.MULTILINE)
        if class_name and variant.write(class_name[1]) == generated.source:
            return variant
    except (msgspec.ValidationError, ArithmeticError, LookupError, ValueError):
        # Values along the axes that the family does not have.
        pass
    raise UsageError(
        f"{generated.name} is not as the family tetris of this version writes it: leave fast out, and the file is run"
    )
