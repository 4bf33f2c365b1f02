"""The curated pools: 234 entries, each specific enough to build on, read from the TOML files in ``pools/``.

Texts of entries are templates. ``{hero}``, ``{home}``, ``{foe}``, ``{foes}`` and ``{a_foe}``, and the same of prize and
block, are filled in from a theme; ``{button}`` and ``{button2}`` are the entry's first and second button, whichever
these turn out to be; all other fields are parameters of the entry.
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
    """What entries of all pools have."""

    id: str
    name: str


class Theme(Entry, frozen=True):
    """Where a game takes place and what it is played with; of foe, prize and block the singular and the plural."""

    scene: str
    hero: str
    foe: tuple[str, str]
    prize: tuple[str, str]
    block: tuple[str, str]
    home: str
    palette: tuple[str, str, str, str]


class Part(Entry, frozen=True, kw_only=True):
    """What has rules, with the parameters in their texts."""

    parameters: dict[str, Range]


class Genre(Part, frozen=True, kw_only=True):
    """`pad` is what moves and buttons do, `loop` what happens, `lend` what another genre takes over from this one."""

    views: tuple[View]
    pad: str
    loop: str
    objects: tuple[str, ...]
    win: str
    loss: str
    lend: str


class Mechanic(Part, frozen=True, kw_only=True):
    """`control` is what it needs: the pad (what the moves do), one button, or nothing. A game has at most one mechanic
    of a `group`.
    """

    control: Literal["pad", "button", "world"]
    views: tuple[View, ...]
    rule: str
    win: str
    loss: str
    group: str | None = None


class Twist(Part, frozen=True, kw_only=True):
    """A rule that changes a game; `needs` is what the game must have for it to mean anything."""

    views: tuple[View, ...]
    rule: str
    needs: Literal["lives", "buttons"] | None = None


class Mashup(Part, frozen=True, kw_only=True):
    """Two or three genres, the first of which gives controls and loop, and the `rule` that joins them."""

    genres: tuple[str, ...]
    rule: str
    win: str
    loss: str


class Experiment(Part, frozen=True, kw_only=True):
    """An idea that is complete by itself."""

    views: tuple[View]
    pad: str
    rule: str
    win: str
    loss: str


class Pools(msgspec.Struct, frozen=True):
    """All pools, each by the ids of its entries, in the order of its file."""

    genres: dict[str, Genre]
    mechanics: dict[str, Mechanic]
    themes: dict[str, Theme]
    twists: dict[str, Twist]
    mashups: dict[str, Mashup]
    experimental: dict[str, Experiment]


_Kind = TypeVar("_Kind", bound=Entry)


@cache
def pools() -> Pools:
    """The pools, read once."""
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
    """The names that are filled into a template, each once, in the order of the text."""
    return tuple(dict.fromkeys(_FIELD.findall(template)))


@cache
def buttons(*templates: str) -> int:
    """How many buttons one entry needs, by its templates."""
    return sum(any(name in fields(template) for template in templates) for name in BUTTONS)


def _read(pool: str, kind: type[_Kind]) -> dict[str, _Kind]:
    text = resources.files(__package__).joinpath("pools", f"{pool}.toml").read_text("utf-8")
    return {key: msgspec.convert({"id": key, **table}, kind) for key, table in tomllib.loads(text).items()}
