"""The family `tetris`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from random import Random
from typing import TYPE_CHECKING, Any

import msgspec

from envcraft.environments.families import Family, Generated
from envcraft.errors import UsageError
from envcraft_tetris.axes.controls import Controls
from envcraft_tetris.values import value_of
from envcraft_tetris.variant import Variant

if TYPE_CHECKING:
    from gymnasium.vector import AutoresetMode

    from envcraft_tetris.vectorized.simulator import Simulator

#: The kinds of environments, by the control that drops a piece.
_KINDS = {"button": "a button drops pieces", "down": "down drops pieces", "none": "nothing drops pieces"}
#: The draws in a row of which one must have the values of --where. The rarest single values come once in some hundred.
_PATIENCE = 50_000


class TetrisFamily(Family):
    """Falling-piece games under the contract ``arcade``.

    Args:
        axes: The values of some axes by dotted names.
    """

    name = "tetris"
    summary = "falling pieces: boards, pieces, controls, clearing, goals and looks drawn at random (contract arcade)"

    def __init__(self, axes: Mapping[str, str | float] | None = None) -> None:
        self._axes = dict(axes or {})

    def generate(self, count: int, seed: int, difficulty: float | None = None) -> Iterator[Generated]:
        """Generate `count` variants with distinct rules. Each is named after the number of its draw.

        Raises:
            UsageError: None of many draws has the values of --where.
        """
        rng = Random(seed)
        known: set[object] = set()
        last = written = 0
        # Rejected draws keep their numbers, so that a stricter filter renames no variant.
        for number in itertools.count():
            if written == count:
                return
            if number - last > _PATIENCE:
                wanted = " and ".join(f"{axis}={value}" for axis, value in self._axes.items())
                advice = "ask for fewer values at once" if len(self._axes) > 1 else "it is rare; try another --seed"
                raise UsageError(f"--where: none of {_PATIENCE:,} draws has {wanted}; {advice}")
            variant = Variant.draw(rng)
            if variant.rules in known or not variant.fair:
                continue
            known.add(variant.rules)
            if not self._matches(variant):
                continue
            last, written = number, written + 1
            source = variant.write(f"Tetris{number:04}")
            yield Generated(f"tetris_{seed}_{number:04}", source, {"axes": variant.axes()})

    def where(self, axes: Mapping[str, str]) -> TetrisFamily:
        return TetrisFamily({**self._axes, **{axis: value_of(axis, text) for axis, text in axes.items()}})

    def _matches(self, variant: Variant) -> bool:
        return all(attrgetter(axis)(variant) == value for axis, value in self._axes.items())

    def kind(self, metadata: dict[str, Any]) -> str:
        """The control that drops a piece at once. Episodes last longer for players that never use it."""
        return _KINDS[Controls(**metadata["axes"]["controls"]).drop] if "axes" in metadata else ""

    def simulate(self, generated: Sequence[Generated], autoreset_mode: AutoresetMode, copy: bool) -> Simulator:
        """Simulate generated environments in this process. Raises UsageError without numba or for a changed source."""
        from envcraft_tetris.vectorized.simulator import Simulator

        known: dict[str, Variant] = {}
        for one in generated:
            if one.source not in known:
                known[one.source] = variant_of(one)
        return Simulator([known[one.source] for one in generated], autoreset_mode, copy)


def variant_of(generated: Generated) -> Variant:
    """Recover the variant of a generated environment from its metadata.

    Raises:
        UsageError: The source differs from the source that this version writes for the variant.
    """
    try:
        variant = msgspec.convert(generated.metadata.get("axes"), Variant)
        class_name = re.search(r"^class (\w+)\(", generated.source, re.MULTILINE)
        if class_name and variant.write(class_name[1]) == generated.source:
            return variant
    except (msgspec.ValidationError, ArithmeticError, LookupError, ValueError):
        # The metadata has values that no axis has.
        pass
    raise UsageError(
        f"the source of {generated.name} is not what this version of the family tetris writes; omit fast to run the "
        "source itself"
    )
