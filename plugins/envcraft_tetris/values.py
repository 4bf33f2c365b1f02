"""The values that each axis can have, for ``--where``. A test draws variants and compares."""

from __future__ import annotations

from collections.abc import Sequence

from envcraft.errors import UsageError
from envcraft.registry import lookup
from envcraft_tetris.axes import (
    board,
    clearing,
    controls,
    ending,
    entry,
    garbage,
    gravity,
    locking,
    look,
    pieces,
    rewards,
    rotation,
    supply,
)

_BOOL = (False, True)
#: Thousandths from 0 to 1.
_HUES = tuple(number / 1000 for number in range(1001))
#: The values of all axes that are no sequences, by dotted names.
VALUES: dict[str, Sequence[str | float]] = {
    "board.rows": range(11, 21),
    "board.columns": range(6, 13),
    "board.shape": board.SHAPES,
    "board.wrap": _BOOL,
    "pieces.family": pieces.SETS,
    "supply.order": supply.ORDERS,
    "supply.preview": range(4),
    "supply.memory": range(5),
    "supply.tries": (0, *range(2, 7)),
    "entry.place": entry.PLACES,
    "entry.step": range(4),
    "controls.up": ("", "cw", "ccw", "hold"),
    "controls.down": ("", "soft", "hard"),
    "controls.first": tuple(controls.FUNCTIONS),
    "controls.second": tuple(controls.FUNCTIONS),
    "controls.press": controls.PRESSES,
    "controls.rest": range(13),
    "rotation.system": rotation.SYSTEMS,
    "rotation.kicks": tuple(rotation.KICKS),
    "gravity.schedule": gravity.SCHEDULES,
    "gravity.slow": range(1, 7),
    "gravity.fast": range(1, 7),
    "gravity.every": (*range(11), *range(20, 61, 10), *range(80, 161, 20)),
    "locking.kind": locking.KINDS,
    "locking.delay": range(6),
    "locking.resets": (0, *range(2, 6)),
    "clearing.rule": clearing.RULES,
    "clearing.colours": (0, 3, 4, 5),
    "clearing.group": (0, *range(5, 18)),
    "garbage.rhythm": garbage.RHYTHMS,
    "garbage.start": (0, 2, 3, 4),
    "garbage.every": (0, *range(3, 10), *range(30, 81, 5)),
    "garbage.holes": garbage.HOLES,
    "ending.goal": ending.GOALS,
    "ending.count": (0, *range(3, 14), *range(16, 25)),
    "ending.steps": (0, *range(300, 951, 50)),
    "ending.ceiling": (0, 2, 3),
    "rewards.clears": rewards.CLEARS,
    "rewards.extra": rewards.EXTRAS,
    "rewards.line": (0.5, 1.0, 2.0),
    "rewards.prize": (0.0, 2.0, 5.0, 10.0),
    "rewards.death": (0.0, 1.0, 2.0, 3.0, 5.0),
    "look.theme": look.THEMES,
    "look.style": look.STYLES,
    "look.field": look.FIELDS,
    "look.ghost": _BOOL,
    "look.panel": ("left", "right"),
    "look.hue": _HUES,
    "look.first": _HUES,
}


def value_of(axis: str, text: str) -> str | float:
    """The value of an axis that a text names. Raises UsageError if there is no such axis, or it has no such value."""
    values: Sequence[str | float] = lookup("axis", axis, VALUES)
    for value in values:
        if str(value).lower() == text.lower() or (not isinstance(value, str | bool) and _number(text) == value):
            return value
    raise UsageError(f"--where {axis}={text}: {axis} is {_words(values)}", setting="where")


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _words(values: Sequence[str | float]) -> str:
    """The values of an axis in words."""
    if isinstance(values, range):
        return f"from {values[0]} to {values[-1]}"
    if values is _HUES:
        return "from 0 to 1, in steps of 0.001"
    *names, last = [str(value).lower() for value in values if value != ""]
    return f"{', '.join(names)} or {last}"
