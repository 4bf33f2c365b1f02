"""The curated pools, loaded from the TOML files in ``pools/``.

The texts of entries are templates. A theme fills ``{hero}``, ``{home}``, ``{foe}``, ``{foes}`` and ``{a_foe}``, and the
same of prize and block. ``{button}`` and ``{button2}`` are the entry's first and second button; which of the game's
buttons these are depends on the combination. All other fields are parameters of the entry.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib import resources
from typing import Literal, TypeAlias, TypeVar

import msgspec

View: TypeAlias = Literal["grid", "top", "side"]
#: Lowest value, highest value, and the step between values.
Range: TypeAlias = tuple[float, float, float]

THEMED = frozenset(
    ["hero", "home", *(form.format(noun) for noun in ("foe", "prize", "block") for form in ("{}", "{}s", "a_{}"))]
)
BUTTONS = ("button", "button2")
_FIELD = re.compile(r"\{(\w+)\}")


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An entry of a pool."""

    id: str
    name: str


class Theme(Entry, frozen=True):
    """The place and the nouns of a game; foe, prize and block have singular and plural."""

    scene: str
    hero: str
    foe: tuple[str, str]
    prize: tuple[str, str]
    block: tuple[str, str]
    home: str
    palette: tuple[str, str, str, str]


class Part(Entry, frozen=True, kw_only=True):
    """An entry with rules and the ranges of their parameters."""

    parameters: dict[str, Range]


class Genre(Part, frozen=True, kw_only=True):
    """A genre: `pad` says what moves and buttons do, `loop` what happens, `lend` the rule that it lends to a blend."""

    views: tuple[View]
    pad: str
    loop: str
    objects: tuple[str, ...]
    win: str
    loss: str
    lend: str


class Mechanic(Part, frozen=True, kw_only=True):
    """A mechanic: `control` is the control that it needs, if any. A game has at most one mechanic of a `group`."""

    control: Literal["pad", "button", "world"]
    views: tuple[View, ...]
    rule: str
    win: str
    loss: str
    group: str | None = None


class Twist(Part, frozen=True, kw_only=True):
    """A rule that changes a game; `needs` is what the game must have for the rule to matter."""

    views: tuple[View, ...]
    rule: str
    needs: Literal["lives", "buttons"] | None = None


class Mashup(Part, frozen=True, kw_only=True):
    """Two or three genres and the `rule` that joins them; the first genre gives controls and loop."""

    genres: tuple[str, ...]
    rule: str
    win: str
    loss: str


class Experiment(Part, frozen=True, kw_only=True):
    """An experimental idea that needs no other ingredient."""

    views: tuple[View]
    pad: str
    rule: str
    win: str
    loss: str


class Pools(msgspec.Struct, frozen=True):
    """All pools: entries by id, in file order."""

    genres: dict[str, Genre]
    mechanics: dict[str, Mechanic]
    themes: dict[str, Theme]
    twists: dict[str, Twist]
    mashups: dict[str, Mashup]
    experimental: dict[str, Experiment]


_Kind = TypeVar("_Kind", bound=Entry)


@cache
def pools() -> Pools:
    """Load the pools once."""
    return Pools(
        _read("genres", Genre),
        _read("mechanics", Mechanic),
        _read("themes", Theme),
        _read("twists", Twist),
        _read("mashups", Mashup),
        _read("experimental", Experiment),
    )


@cache
def fields(template: str) -> tuple[str, ...]:
    """Return the field names of a template, without repetition, in text order."""
    return tuple(dict.fromkeys(_FIELD.findall(template)))


@cache
def buttons(*templates: str) -> int:
    """Return how many buttons an entry needs, by its templates."""
    return sum(any(name in fields(template) for template in templates) for name in BUTTONS)


def _read(pool: str, kind: type[_Kind]) -> dict[str, _Kind]:
    text = resources.files(__package__).joinpath("pools", f"{pool}.toml").read_text("utf-8")
    return {key: msgspec.convert({"id": key, **table}, kind) for key, table in tomllib.loads(text).items()}
