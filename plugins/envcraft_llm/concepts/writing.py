"""Writing of concepts: draws the numbers, fills in nouns and buttons, and composes the text."""

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

#: Range of the initial lives, and of the step limit of a game that is not won by survival.
LIVES: Range = (2, 4, 1)
LIMIT: Range = (800, 1000, 50)

_VIEWS: dict[View, str] = {
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
    """An idea for a game.

    Attributes:
        id: The first 16 characters of `text_sha256`.
        strategy: Name of the strategy.
        title: Title of the game.
        ingredients: Names of entries, such as ``theme:coral-reef``.
        parameters: The numbers in the text, by entry.
        text: The text.
        text_sha256: Digest of the text without case, punctuation and spacing.
    """

    id: str
    strategy: str
    title: str
    ingredients: list[str]
    parameters: dict[str, int | float]
    text: str
    text_sha256: str


class Clause(NamedTuple):
    """A template and the entry that its parameters belong to."""

    part: Part
    template: str


class Draft(NamedTuple):
    """A combination of ingredients, with the clause that each contributes."""

    strategy: str
    title: str
    summary: str
    ingredients: tuple[str, ...]
    theme: Theme
    view: View
    controls: list[Clause]
    rules: list[Clause]
    win: Clause
    loss: Clause
    objects: tuple[str, ...] = ()


def takes_lives(clauses: Iterable[Clause]) -> bool:
    """Whether these clauses can cost a life."""
    return any(_costs_life(template) for _, template in clauses)


def write(draft: Draft, rng: random.Random) -> Concept:
    """Write the concept of a draft, with numbers drawn from `rng`."""
    theme, clauses = draft.theme, [*draft.controls, *draft.rules]
    all_clauses = [*clauses, draft.win, draft.loss]
    values = _Values(theme, rng)
    win = values.clause(draft.win)
    controls = [values.sentences(clause) for clause in draft.controls]
    rules = [values.sentences(clause) for clause in draft.rules]
    lost = [values.clause(draft.loss)]
    if takes_lives(all_clauses):
        lost.append(f"the last of {values.draw('lives', LIVES)} lives is lost")
    if "last" not in fields(draft.win.template):
        lost.append(f"{values.draw('limit', LIMIT)} steps have passed without a win")
    title = f"{theme.name}: {draft.title}"
    text = "\n".join(
        [
            f"{title}.",
            f"{draft.summary} The place is {theme.scene}, and the player is the {theme.hero}. {_VIEWS[draft.view]}",
            f"Controls: {' '.join([*controls, *values.idle_buttons()])}",
            f"Rules: {' '.join([*rules, *_distinction(theme, clauses)])}",
            f"Win: the game is won when {win}.",
            f"Loss: the game is lost when {', when '.join(lost[:-1])}{', or when ' if lost[1:] else ''}{lost[-1]}.",
            _picture(draft, all_clauses),
        ]
    )
    digest = text_sha256(text)
    return Concept(digest[:16], draft.strategy, title, list(draft.ingredients), values.named(), text, digest)


def text_sha256(text: str) -> str:
    """Return the digest that identifies a text; case, punctuation, spacing and Unicode forms do not affect it."""
    plain = " ".join(unicodedata.normalize("NFKC", text).casefold().translate(_SPACED).split())
    return hashlib.sha256(plain.encode()).hexdigest()


class _Values:
    """The values of one concept's templates."""

    def __init__(self, theme: Theme, rng: random.Random) -> None:
        self._rng = rng
        self._words = _nouns(theme.id, theme.hero, theme.home, theme.foe, theme.prize, theme.block)
        self._buttons: dict[tuple[str, str], str] = {}
        self._known: dict[tuple[str, str], int | float] = {}

    def sentences(self, clause: Clause) -> str:
        """Fill a template of whole sentences."""
        return self._filled(clause.part, _capitalised(clause.template))

    def clause(self, clause: Clause) -> str:
        """Fill a template within a sentence."""
        return self._filled(clause.part, clause.template)

    def draw(self, name: str, within: Range) -> int | float:
        """Draw a number of the game itself."""
        return self._known.setdefault(("game", name), _drawn(within, self._rng))

    def idle_buttons(self) -> list[str]:
        """Return the sentence about buttons that no rule uses. Call it after all rules are filled in."""
        if not self._buttons:
            return ["Neither button is used."]
        return ["The second button is not used."] if len(self._buttons) == 1 else []

    def named(self) -> dict[str, int | float]:
        """Return all numbers by entry and parameter."""
        return {f"{part}.{name}": value for (part, name), value in self._known.items()}

    def _filled(self, part: Part, template: str) -> str:
        """Fill a template; a parameter of an entry has the same value everywhere."""
        single = False
        values: dict[str, object] = {}
        for name in fields(template):
            if name in self._words:
                values[name] = self._words[name]
            elif (small := name.lower()) in BUTTONS:
                if (part.id, small) not in self._buttons:
                    self._buttons[part.id, small] = _ORDINALS[len(self._buttons)]
                words = self._buttons[part.id, small]
                values[name] = words if name == small else _capital(words)
            else:
                if (part.id, name) not in self._known:
                    self._known[part.id, name] = _drawn(part.parameters[name], self._rng)
                value = self._known[part.id, name]
                values[name] = value
                single |= value == 1
        text = template.format_map(values)
        return _SINGLE.sub(r"1 \1", text) if single else text


def _capital(words: str) -> str:
    return words[0].upper() + words[1:]


@cache
def _nouns(
    _theme: str, hero: str, home: str, foe: tuple[str, str], prize: tuple[str, str], block: tuple[str, str]
) -> dict[str, str]:
    """Return the nouns of a theme by field; a capitalised field has capitalised words."""
    words = {"hero": hero, "home": home}
    for name, (one, many) in (("foe", foe), ("prize", prize), ("block", block)):
        article = "an" if one[0] in "aeiou" else "a"
        words |= {name: one, f"{name}s": many, f"a_{name}": f"{article} {one}"}
    return words | {name.capitalize(): _capital(word) for name, word in words.items()}


@cache
def _capitalised(template: str) -> str:
    """Return a template with capitalised fields at the start of sentences."""

    def capital(match: re.Match[str]) -> str:
        name = match[2].capitalize() if match[2] in THEMED or match[2] in BUTTONS else match[2]
        return f"{match[1]}{{{name}}}"

    return _START.sub(capital, template)


@cache
def _costs_life(template: str) -> bool:
    return _LIFE.search(template) is not None


@cache
def _roles(template: str) -> frozenset[str]:
    """Return the nouns of a theme that a template uses, in the singular."""
    return frozenset(name.removeprefix("a_").removesuffix("s") for name in fields(template) if name in THEMED)


def _drawn(within: Range, rng: random.Random) -> int | float:
    lowest, highest, step = within
    # Faster than randrange, and even enough for a few values.
    value = lowest + step * int(rng.random() * (round((highest - lowest) / step) + 1))
    return int(value) if value == int(value) else round(value, 3)


def _distinction(theme: Theme, clauses: Sequence[Clause]) -> list[str]:
    """Return a sentence that separates the objects of rules with the same noun."""
    users: dict[str, set[str]] = {"foe": set(), "prize": set(), "block": set()}
    for part, template in clauses:
        # A mashup refers to the objects of its genres.
        if not isinstance(part, Mashup):
            for role in _roles(template) & users.keys():
                users[role].add(part.id)
    shared = [getattr(theme, role)[1] for role, parts in users.items() if len(parts) > 1]
    if not shared:
        return []
    return [
        f"Where several rules speak of {_listed(shared, 'or')}, each rule means its own kind, in a shade of its own."
    ]


def _picture(draft: Draft, clauses: Sequence[Clause]) -> str:
    theme = draft.theme
    roles = frozenset[str]().union(*(_roles(template) for _, template in clauses))
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
    """Join words as a list in a sentence: "a", "a or b", "a, b or c"."""
    return f"{', '.join(words[:-1])} {last} {words[-1]}" if words[1:] else words[0]
