"""From ingredients to a concept: numbers drawn, nouns and buttons filled in, and one text that says all of it."""

from __future__ import annotations

import hashlib
import random
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import msgspec

from .pools import BUTTONS, THEMED, Mashup, Part, Theme, View, fields

#: With so many lives a game begins that takes any, and after so many steps one ends that is not won by lasting.
LIVES, LIMIT = (2, 4, 1), (800, 1000, 50)

_SEEN = {
    "grid": "It is seen from above, on a board of square cells.",
    "top": "It is seen from above.",
    "side": "It is seen from the side.",
}
_ORDINALS = ("the first button", "the second button")
_START = re.compile(r"(?:^|(?<=[.:] )|(?<=\n))[a-z]", re.MULTILINE)
_SINGLE = re.compile(r"\b1 (pixel|step|cell|degree|unit|hit|level|life)s?\b")
_NO_WORD = re.compile(r"[^\w]+")
_LIFE = re.compile(r"\ba life\b")


class Concept(msgspec.Struct, frozen=True):
    """An idea for a game. `ingredients` are names of entries, such as ``theme:coral-reef``, `parameters` the numbers in
    the text; `text_sha256` is the digest of the text without case, punctuation and spacing, and `id` its beginning.
    """

    id: str
    strategy: str
    title: str
    ingredients: list[str]
    parameters: dict[str, int | float]
    text: str
    text_sha256: str


class Said(NamedTuple):
    """A template, and the entry whose parameters it has."""

    part: Part
    template: str


class Draft(NamedTuple):
    """Ingredients that go together, and what each of them says in the concept."""

    strategy: str
    title: str
    summary: str
    ingredients: tuple[str, ...]
    theme: Theme
    view: View
    controls: list[Said]
    rules: list[Said]
    win: Said
    losses: list[Said]
    objects: tuple[str, ...] = ()


def takes_lives(said: Iterable[Said]) -> bool:
    """Whether a life can be lost in a game with these rules."""
    return any(_LIFE.search(template) for _, template in said)


def write(draft: Draft, rng: random.Random) -> Concept:
    """The concept that a draft makes, with numbers drawn from `rng`."""
    theme = draft.theme
    everything = [*draft.controls, *draft.rules, draft.win, *draft.losses]
    values = _Values(theme, rng)
    win = values.fill(draft.win)
    lines = [
        f"{theme.name}: {draft.title}.",
        f"{draft.summary} The place is {theme.scene}, and the player is the {theme.hero}. {_SEEN[draft.view]}",
        "Controls: " + " ".join([*map(values.fill, draft.controls)]),
        "Rules: " + " ".join([*map(values.fill, draft.rules), *_kept_apart(theme, [*draft.controls, *draft.rules])]),
        f"Win: the game is won when {win}.",
    ]
    lost = [values.fill(said) for said in draft.losses]
    if takes_lives(everything):
        lost.append(f"the last of {values.draw('lives', LIVES)} lives is lost")
    if "last" in fields(draft.win.template):
        limit = values.known[draft.win.part.id, "last"]
    else:
        limit = values.draw("limit", LIMIT)
        lost.append(f"{limit} steps have passed without a win")
    lines.append(f"Loss: the game is lost when {_listed(lost, 'or when')}.")
    lines[2] += values.idle_buttons()
    lines.append(_picture(draft, everything))
    text = _START.sub(lambda found: found[0].upper(), "\n".join(lines))
    text = _SINGLE.sub(r"1 \1", text)
    digest = text_sha256(text)
    return Concept(digest[:16], draft.strategy, lines[0][:-1], list(draft.ingredients), values.named(), text, digest)


def text_sha256(text: str) -> str:
    """The digest by which two concepts are the same: case, punctuation, spacing and forms of letters do not count."""
    plain = _NO_WORD.sub(" ", unicodedata.normalize("NFKC", text).casefold()).strip()
    return hashlib.sha256(plain.encode()).hexdigest()


class _Values:
    """What is filled into the templates of one concept."""

    def __init__(self, theme: Theme, rng: random.Random) -> None:
        self._rng = rng
        self._words = _nouns(theme)
        self._buttons: dict[tuple[str, str], str] = {}
        self.known: dict[tuple[str, str], int | float] = {}

    def fill(self, said: Said) -> str:
        """The text of a template. The same parameter of the same entry has one value throughout."""
        part, template = said
        found: dict[str, object] = {}
        for name in fields(template):
            if name in THEMED:
                found[name] = self._words[name]
            elif name in BUTTONS:
                key = part.id, name
                if key not in self._buttons:
                    self._buttons[key] = _ORDINALS[len(self._buttons)]
                found[name] = self._buttons[key]
            else:
                key = part.id, name
                if key not in self.known:
                    self.known[key] = _drawn(part.parameters[name], self._rng)
                found[name] = self.known[key]
        return template.format_map(found)

    def draw(self, name: str, within: tuple[float, float, float]) -> int | float:
        """A number of the concept itself."""
        self.known["game", name] = _drawn(within, self._rng)
        return self.known["game", name]

    def idle_buttons(self) -> str:
        """What to say of buttons that no rule needs."""
        used = len(self._buttons)
        return (" Neither button is used.", " The second button is not used.", "")[used]

    def named(self) -> dict[str, int | float]:
        return {f"{part}.{name}": value for (part, name), value in self.known.items()}


def _nouns(theme: Theme) -> dict[str, str]:
    words = {"hero": theme.hero, "home": theme.home}
    for name, (one, many) in (("foe", theme.foe), ("prize", theme.prize), ("block", theme.block)):
        article = "an" if one[0] in "aeiou" else "a"
        words |= {name: one, f"{name}s": many, f"a_{name}": f"{article} {one}"}
    return words


def _drawn(within: tuple[float, float, float], rng: random.Random) -> int | float:
    lowest, highest, step = within
    value = lowest + step * rng.randrange(round((highest - lowest) / step) + 1)
    return int(value) if value == int(value) else round(value, 3)


def _roles(template: str) -> set[str]:
    names = {name.removeprefix("a_") for name in fields(template) if name in THEMED}
    return {name[:-1] if name.endswith("s") else name for name in names}


def _kept_apart(theme: Theme, said: Sequence[Said]) -> list[str]:
    """A sentence where several entries speak of what has one name, since each means its own."""
    users: dict[str, set[str]] = {"foe": set(), "prize": set(), "block": set()}
    for part, template in said:
        # A mashup speaks of what its genres have.
        for role in _roles(template) & users.keys() if not isinstance(part, Mashup) else ():
            users[role].add(part.id)
    shared = [getattr(theme, role)[1] for role, parts in users.items() if len(parts) > 1]
    if not shared:
        return []
    return [
        f"Where several rules speak of {_listed(shared, 'or')}, each means its own, which have a shade of their own."
    ]


def _picture(draft: Draft, said: Sequence[Said]) -> str:
    theme = draft.theme
    roles = {"hero"}.union(*(_roles(template) for _, template in said))
    words = _nouns(theme)
    things = [
        words[role if role in ("hero", "home") else f"{role}s"]
        for role in ("hero", "foe", "prize", "block", "home")
        if role in roles
    ]
    things += draft.objects
    return (
        f"Picture: 84 by 84 pixels without any text, in {_listed(theme.palette, 'and')}. "
        f"To be told apart at a glance: {_listed(things, 'and')}. Counts are shown as dots or bars along an edge."
    )


def _listed(words: Sequence[str], last: str) -> str:
    """ "a", "a or b", "a, b or c"; with a comma before a `last` of several words."""
    if len(words) < 2:
        return "".join(words)
    comma = "," if " " in last else ""
    return f"{', '.join(words[:-1])}{comma} {last} {words[-1]}"
