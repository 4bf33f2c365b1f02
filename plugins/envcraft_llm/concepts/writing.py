"""From ingredients to a concept: numbers drawn, nouns and buttons filled in, and one text that says all of it."""

from __future__ import annotations

import hashlib
import random
import re
import string
import unicodedata
from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

import msgspec

from .pools import BUTTONS, THEMED, Mashup, Part, Range, Theme, View, fields

#: With so many lives a game begins that takes any, and after so many steps one ends that is not won by lasting.
LIVES: Range = (2, 4, 1)
LIMIT: Range = (800, 1000, 50)

_SEEN: dict[View, str] = {
    "grid": "It is seen from above, on a board of square cells.",
    "top": "It is seen from above.",
    "side": "It is seen from the side.",
}
_ORDINALS = ("the first button", "the second button")
_START = re.compile(r"(^|\. )\{(\w+)\}")
_SINGLE = re.compile(r"(?<![.\d])1 (pixel|step|cell|degree|unit|hit|level)s?\b")
_SPACED = str.maketrans(dict.fromkeys(string.punctuation, " "))
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
    loss: Said
    objects: tuple[str, ...] = ()


def takes_lives(said: Iterable[Said]) -> bool:
    """Whether a life can be lost in a game with these rules."""
    return any(_costs_life(template) for _, template in said)


def write(draft: Draft, rng: random.Random) -> Concept:
    """The concept that a draft makes, with numbers drawn from `rng`."""
    theme, spoken = draft.theme, [*draft.controls, *draft.rules]
    everything = [*spoken, draft.win, draft.loss]
    values = _Values(theme, rng)
    win = values.clause(draft.win)
    controls = [values.sentences(said) for said in draft.controls]
    rules = [values.sentences(said) for said in draft.rules]
    lost = [values.clause(draft.loss)]
    if takes_lives(everything):
        lost.append(f"the last of {values.draw('lives', LIVES)} lives is lost")
    if "last" not in fields(draft.win.template):
        lost.append(f"{values.draw('limit', LIMIT)} steps have passed without a win")
    title = f"{theme.name}: {draft.title}"
    text = "\n".join(
        [
            f"{title}.",
            f"{draft.summary} The place is {theme.scene}, and the player is the {theme.hero}. {_SEEN[draft.view]}",
            f"Controls: {' '.join([*controls, *values.idle_buttons()])}",
            f"Rules: {' '.join([*rules, *_kept_apart(theme, spoken)])}",
            f"Win: the game is won when {win}.",
            f"Loss: the game is lost when {', when '.join(lost[:-1])}{', or when ' if lost[1:] else ''}{lost[-1]}.",
            _picture(draft, everything),
        ]
    )
    digest = text_sha256(text)
    return Concept(digest[:16], draft.strategy, title, list(draft.ingredients), values.named(), text, digest)


def text_sha256(text: str) -> str:
    """The digest by which two concepts are the same: case, punctuation, spacing and forms of letters do not count."""
    plain = " ".join(unicodedata.normalize("NFKC", text).casefold().translate(_SPACED).split())
    return hashlib.sha256(plain.encode()).hexdigest()


class _Values:
    """What is filled into the templates of one concept."""

    def __init__(self, theme: Theme, rng: random.Random) -> None:
        self._rng = rng
        self._words = _nouns(theme.id, theme.hero, theme.home, theme.foe, theme.prize, theme.block)
        self._buttons: dict[tuple[str, str], str] = {}
        self._known: dict[tuple[str, str], int | float] = {}

    def sentences(self, said: Said) -> str:
        """The text of a template that consists of whole sentences."""
        return self._filled(said.part, _capitalised(said.template))

    def clause(self, said: Said) -> str:
        """The text of a template that goes on where a sentence has begun."""
        return self._filled(said.part, said.template)

    def draw(self, name: str, within: Range) -> int | float:
        """A number of the game itself."""
        return self._known.setdefault(("game", name), _drawn(within, self._rng))

    def idle_buttons(self) -> list[str]:
        """What to say of buttons that no rule needs, once all rules are filled in."""
        if not self._buttons:
            return ["Neither button is used."]
        return ["The second button is not used."] if len(self._buttons) == 1 else []

    def named(self) -> dict[str, int | float]:
        """All numbers, by entry and parameter."""
        return {f"{part}.{name}": value for (part, name), value in self._known.items()}

    def _filled(self, part: Part, template: str) -> str:
        """The same parameter of the same entry has one value throughout."""
        single = False
        found: dict[str, object] = {}
        for name in fields(template):
            if name in self._words:
                found[name] = self._words[name]
            elif (small := name.lower()) in BUTTONS:
                if (part.id, small) not in self._buttons:
                    self._buttons[part.id, small] = _ORDINALS[len(self._buttons)]
                words = self._buttons[part.id, small]
                found[name] = words if name == small else _capital(words)
            else:
                if (part.id, name) not in self._known:
                    self._known[part.id, name] = _drawn(part.parameters[name], self._rng)
                value = self._known[part.id, name]
                found[name] = value
                single |= value == 1
        text = template.format_map(found)
        return _SINGLE.sub(r"1 \1", text) if single else text


def _capital(words: str) -> str:
    return words[0].upper() + words[1:]


@cache
def _nouns(
    _theme: str, hero: str, home: str, foe: tuple[str, str], prize: tuple[str, str], block: tuple[str, str]
) -> dict[str, str]:
    """What is filled in from a theme; under a name with a capital, words with a capital."""
    words = {"hero": hero, "home": home}
    for name, (one, many) in (("foe", foe), ("prize", prize), ("block", block)):
        article = "an" if one[0] in "aeiou" else "a"
        words |= {name: one, f"{name}s": many, f"a_{name}": f"{article} {one}"}
    return words | {name.capitalize(): _capital(word) for name, word in words.items()}


@cache
def _capitalised(template: str) -> str:
    """A template whose nouns and buttons at the beginning of sentences have names with a capital."""

    def capital(found: re.Match[str]) -> str:
        name = found[2].capitalize() if found[2] in THEMED or found[2] in BUTTONS else found[2]
        return f"{found[1]}{{{name}}}"

    return _START.sub(capital, template)


@cache
def _costs_life(template: str) -> bool:
    return _LIFE.search(template) is not None


@cache
def _roles(template: str) -> frozenset[str]:
    """Of a theme's nouns those that a template has, in the singular."""
    return frozenset(name.removeprefix("a_").removesuffix("s") for name in fields(template) if name in THEMED)


def _drawn(within: Range, rng: random.Random) -> int | float:
    lowest, highest, step = within
    # Quicker than randrange, and as even as these few values need.
    value = lowest + step * int(rng.random() * (round((highest - lowest) / step) + 1))
    return int(value) if value == int(value) else round(value, 3)


def _kept_apart(theme: Theme, spoken: Sequence[Said]) -> list[str]:
    """A sentence where several entries speak of what has one name, since each means its own."""
    users: dict[str, set[str]] = {"foe": set(), "prize": set(), "block": set()}
    for part, template in spoken:
        # A mashup speaks of what its genres have.
        if not isinstance(part, Mashup):
            for role in _roles(template) & users.keys():
                users[role].add(part.id)
    shared = [getattr(theme, role)[1] for role, parts in users.items() if len(parts) > 1]
    if not shared:
        return []
    return [
        f"Where several rules speak of {_listed(shared, 'or')}, each rule means its own kind, in a shade of its own."
    ]


def _picture(draft: Draft, said: Sequence[Said]) -> str:
    theme = draft.theme
    roles = frozenset[str]().union(*(_roles(template) for _, template in said))
    nouns = (("foe", theme.foe[1]), ("prize", theme.prize[1]), ("block", theme.block[1]), ("home", theme.home))
    things = [theme.hero, *(noun for role, noun in nouns if role in roles), *draft.objects]
    shown = (
        f"To be told apart at a glance are {_listed(things, 'and')}." if things[1:] else f"Shown is the {things[0]}."
    )
    return (
        f"Picture: 84 by 84 pixels without any text, in {_listed(theme.palette, 'and')}. {shown} "
        "Counts are shown as dots or bars along an edge."
    )


def _listed(words: Sequence[str], last: str) -> str:
    """Words as a list in a sentence: "a", "a or b", "a, b or c"."""
    return f"{', '.join(words[:-1])} {last} {words[-1]}" if words[1:] else words[0]
