"""The four strategies that choose ingredients; each draws drafts endlessly and uses its pools evenly."""

from __future__ import annotations

import itertools
import random
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Generic, TypeVar

from .pools import Entry, Experiment, Genre, Mechanic, Part, Pools, Theme, Twist, View, buttons
from .writing import Clause, Draft, takes_lives

_Kind = TypeVar("_Kind", bound=Entry)

#: Number of buttons of a game.
BUTTONS = 2
#: Number of mechanics of a mechanical concept.
MECHANICS = 4
#: One in this many blends is a mashup.
MASHUPS = 4

#: What the pad does if no ingredient says so.
MOVES: dict[View, Clause] = {
    "grid": Clause(
        Part(id="pad", name="walking", parameters={"pace": (2, 4, 1)}),
        "Each move takes the {hero} one cell on a board of 14 by 14, and the next can follow {pace} steps later.",
    ),
    "top": Clause(
        Part(id="pad", name="walking", parameters={"speed": (1, 3, 0.5)}),
        "The pad moves the {hero} {speed} pixels a step in four directions.",
    ),
    "side": Clause(
        Part(id="pad", name="walking", parameters={"speed": (1, 2, 0.5), "height": (14, 22, 2), "ledges": (4, 7, 1)}),
        "Left and right walk {speed} pixels a step, up jumps {height} pixels high, and down drops through the thin "
        "ledges, of which {ledges} hang above the floor.",
    ),
}


class Deck(Generic[_Kind]):
    """A pool dealt like cards: in random order, every fitting entry once before any entry twice."""

    def __init__(self, entries: Iterable[_Kind], rng: random.Random) -> None:
        self._all = list(entries)
        self._left: list[_Kind] = []
        self._rng = rng

    def take(self, fits: Callable[[_Kind], bool] = lambda _: True) -> _Kind:
        """Deal the next entry that fits. Raises LookupError if no entry of the pool fits."""
        for _ in range(2):
            for place in range(len(self._left) - 1, -1, -1):
                if fits(self._left[place]):
                    return self._left.pop(place)
            # Entries that do not fit stay in the deck and are not added again.
            refill = [entry for entry in self._all if fits(entry)]
            self._rng.shuffle(refill)
            self._left += refill
        raise LookupError("no entry of the pool fits")


class Strategy(ABC):
    """Chooses ingredients. Two drafts may be equal."""

    name: str

    def __init__(self, pools: Pools, rng: random.Random) -> None:
        self.pools, self.rng = pools, rng
        self.themes: Deck[Theme] = Deck(pools.themes.values(), rng)

    @property
    @abstractmethod
    def capacity(self) -> int:
        """The number of distinct combinations."""

    @abstractmethod
    def draw(self) -> Draft:
        """Draw a draft."""


class GenreBlend(Strategy):
    """Three genres: one gives controls, loop and goal, the other two lend it a rule each.

    One blend in four is a mashup, whose rule and goal replace those that its genres would lend.
    """

    name = "genre-blend"

    def __init__(self, pools: Pools, rng: random.Random) -> None:
        super().__init__(pools, rng)
        self._hosts, self._guests = Deck(pools.genres.values(), rng), Deck(pools.genres.values(), rng)
        self._mashups = Deck(pools.mashups.values(), rng)
        self._drawn = 0

    @cached_property
    def capacity(self) -> int:
        genres = list(self.pools.genres.values())
        blends = sum(
            buttons(host.pad) + buttons(one.lend) + buttons(two.lend) <= BUTTONS
            for host in genres
            for one, two in itertools.combinations(genres, 2)
            if host not in (one, two)
        )
        joined = 0
        for mashup in self.pools.mashups.values():
            host = self.pools.genres[mashup.genres[0]]
            joined += len(mashup.genres) > 2 or sum(
                guest.id not in mashup.genres and buttons(host.pad) + buttons(guest.lend) <= BUTTONS for guest in genres
            )
        return (blends + joined) * len(self.pools.themes)

    def draw(self) -> Draft:
        self._drawn += 1
        return self._mashup() if self._drawn % MASHUPS == 0 else self._blend()

    def _blend(self) -> Draft:
        host = self._hosts.take()
        one = self._guest(host, {host.id})
        two = self._guest(host, {host.id, one.id}, buttons(one.lend))
        guests = sorted((one, two), key=lambda guest: guest.id)
        theme = self.themes.take()
        names = f"{host.name} with {guests[0].name} and {guests[1].name}"
        return Draft(
            self.name,
            names,
            f"This is a blend: its genre is {host.name}, a rule each comes from {guests[0].name} and {guests[1].name}.",
            (f"theme:{theme.id}", *(f"genre:{genre.id}" for genre in (host, *guests))),
            theme,
            host.views[0],
            [Clause(host, host.pad)],
            [Clause(host, host.loop), *(Clause(guest, guest.lend) for guest in guests)],
            Clause(host, host.win),
            Clause(host, host.loss),
            host.objects,
        )

    def _mashup(self) -> Draft:
        mashup = self._mashups.take()
        genres = [self.pools.genres[name] for name in mashup.genres]
        host, theme = genres[0], self.themes.take()
        lent: list[Clause] = []
        besides = ""
        if len(genres) < 3:
            guest = self._guest(host, set(mashup.genres))
            genres.append(guest)
            lent = [Clause(guest, guest.lend)]
            besides = f", with a rule of {guest.name} besides"
        blended = " and ".join(self.pools.genres[name].name for name in mashup.genres[1:])
        return Draft(
            self.name,
            mashup.name + besides.replace(" a rule of", "").replace(" besides", ""),
            f"This is {mashup.name}: the genre {host.name} mixed with {blended}{besides}.",
            (f"theme:{theme.id}", f"mashup:{mashup.id}", *(f"genre:{genre.id}" for genre in genres)),
            theme,
            host.views[0],
            [Clause(host, host.pad)],
            [Clause(host, host.loop), Clause(mashup, mashup.rule), *lent],
            Clause(mashup, mashup.win),
            Clause(mashup, mashup.loss),
            host.objects,
        )

    def _guest(self, host: Genre, taken: set[str], pressed: int = 0) -> Genre:
        free = BUTTONS - buttons(host.pad) - pressed
        return self._guests.take(lambda genre: genre.id not in taken and buttons(genre.lend) <= free)


class Mechanical(Strategy):
    """Four mechanics that can be played at once: one for the pad, one or two that need a button, and what the world
    does by itself. One of them says how the game is won, another how it is lost.
    """

    name = "mechanical"

    def __init__(self, pools: Pools, rng: random.Random) -> None:
        super().__init__(pools, rng)
        known = list(pools.mechanics.values())
        self._kinds = {
            kind: [mechanic for mechanic in known if mechanic.control == kind] for kind in ("pad", "button", "world")
        }
        self._decks = {kind: Deck(found, rng) for kind, found in self._kinds.items()}

    @cached_property
    def capacity(self) -> int:
        found = 0
        for pad in self._kinds["pad"]:
            fitting = {
                kind: [mechanic for mechanic in self._kinds[kind] if _goes_with(mechanic, [pad])]
                for kind in ("button", "world")
            }
            for pressed in range(1, BUTTONS - buttons(pad.rule) + 1):
                left = _by_groups(fitting["button"], pressed)
                right = _by_groups(fitting["world"], MECHANICS - 1 - pressed)
                found += sum(left[one] * right[two] for one in left for two in right if not set(one) & set(two))
        return found * len(self.pools.themes)

    def draw(self) -> Draft:
        pad = self._decks["pad"].take()
        pressed = self.rng.randint(1, BUTTONS - buttons(pad.rule))
        chosen = [pad]
        for kind in ["button"] * pressed + ["world"] * (MECHANICS - 1 - pressed):
            chosen.append(self._decks[kind].take(lambda mechanic: _goes_with(mechanic, chosen)))
        chosen[1:] = sorted(chosen[1:], key=lambda mechanic: (mechanic.control, mechanic.id))
        winning, losing = self.rng.sample(chosen, 2)
        theme = self.themes.take()
        names = [mechanic.name for mechanic in chosen]
        return Draft(
            self.name,
            f"{', '.join(names[:-1])} and {names[-1]}",
            f"Four mechanics meet in this game: {', '.join(names[:-1])} and {names[-1]}.",
            (f"theme:{theme.id}", *(f"mechanic:{mechanic.id}" for mechanic in chosen)),
            theme,
            pad.views[0],
            [Clause(mechanic, mechanic.rule) for mechanic in chosen if mechanic.control != "world"],
            [Clause(mechanic, mechanic.rule) for mechanic in chosen if mechanic.control == "world"],
            Clause(winning, winning.win),
            Clause(losing, losing.loss),
        )


class Thematic(Strategy):
    """A theme, one mechanic that is the whole game, and a twist."""

    name = "thematic"

    def __init__(self, pools: Pools, rng: random.Random) -> None:
        super().__init__(pools, rng)
        self._mechanics = Deck(pools.mechanics.values(), rng)
        self._twists = Deck(pools.twists.values(), rng)

    @cached_property
    def capacity(self) -> int:
        pairs = itertools.product(self.pools.twists.values(), self.pools.mechanics.values())
        return sum(_twists(twist, mechanic) for twist, mechanic in pairs) * len(self.pools.themes)

    def draw(self) -> Draft:
        theme, core = self.themes.take(), self._mechanics.take()
        twist = self._twists.take(lambda twist: _twists(twist, core))
        view = self.rng.choice([view for view in core.views if view in twist.views])
        controls, rules = [] if core.control == "pad" else [MOVES[view]], [Clause(twist, twist.rule)]
        (rules if core.control == "world" else controls).insert(
            1 if core.control == "button" else 0, Clause(core, core.rule)
        )
        return Draft(
            self.name,
            f"{core.name}; twist: {twist.name}",
            f"The core of this game is {core.name}, and its twist is {twist.name}.",
            (f"theme:{theme.id}", f"mechanic:{core.id}", f"twist:{twist.id}"),
            theme,
            view,
            controls,
            rules,
            Clause(core, core.win),
            Clause(core, core.loss),
        )


class Experimental(Strategy):
    """An experimental concept, with a theme and a twist."""

    name = "experimental"

    def __init__(self, pools: Pools, rng: random.Random) -> None:
        super().__init__(pools, rng)
        self._ideas = Deck(pools.experimental.values(), rng)
        self._twists = Deck(pools.twists.values(), rng)

    @cached_property
    def capacity(self) -> int:
        pairs = itertools.product(self.pools.twists.values(), self.pools.experimental.values())
        return sum(_twists(twist, idea) for twist, idea in pairs) * len(self.pools.themes)

    def draw(self) -> Draft:
        theme, idea = self.themes.take(), self._ideas.take()
        twist = self._twists.take(lambda twist: _twists(twist, idea))
        return Draft(
            self.name,
            f"{idea.name}; twist: {twist.name}",
            f"This game is an experiment: {idea.name}. Its twist is {twist.name}.",
            (f"theme:{theme.id}", f"experimental:{idea.id}", f"twist:{twist.id}"),
            theme,
            idea.views[0],
            [Clause(idea, idea.pad)],
            [Clause(idea, idea.rule), Clause(twist, twist.rule)],
            Clause(idea, idea.win),
            Clause(idea, idea.loss),
        )


STRATEGIES: tuple[type[Strategy], ...] = (GenreBlend, Mechanical, Thematic, Experimental)


def _goes_with(mechanic: Mechanic, chosen: list[Mechanic]) -> bool:
    """Whether a mechanic is compatible with the chosen ones, the first of which controls the pad."""
    if mechanic in chosen or chosen[0].views[0] not in mechanic.views:
        return False
    return mechanic.group is None or all(mechanic.group != other.group for other in chosen)


def _by_groups(mechanics: list[Mechanic], number: int) -> Counter[tuple[str, ...]]:
    """Count the combinations of this many mechanics by their groups; no combination has a group twice."""
    choices = itertools.combinations(mechanics, number)
    groups_of = (tuple(mechanic.group for mechanic in chosen if mechanic.group) for chosen in choices)
    return Counter(groups for groups in groups_of if len(set(groups)) == len(groups))


def _twists(twist: Twist, core: Mechanic | Experiment) -> bool:
    """Whether a twist matters in a game of this core."""
    if not set(twist.views) & set(core.views):
        return False
    texts = [core.rule, core.pad] if isinstance(core, Experiment) else [core.rule]
    if twist.needs == "lives":
        return takes_lives(Clause(core, text) for text in texts)
    return twist.needs is None or buttons(*texts) > 0
