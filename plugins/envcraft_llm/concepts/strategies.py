"""How ingredients are chosen: four strategies, each of which draws drafts without end and uses its pools evenly."""

from __future__ import annotations

import itertools
import random
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Generic, TypeVar

from .pools import Entry, Experiment, Genre, Mechanic, Part, Pools, Theme, Twist, View, buttons
from .writing import Draft, Said, takes_lives

_Kind = TypeVar("_Kind", bound=Entry)

#: What a player can press.
BUTTONS = 2
#: How many mechanics a mechanical concept has.
MECHANICS = 4
#: Of so many blends one is of a mashup.
MASHUPS = 4

#: What the pad does where no ingredient says so.
MOVES: dict[View, Said] = {
    "grid": Said(
        Part(id="pad", name="walking", parameters={"pace": (2, 4, 1)}),
        "Each move takes the {hero} one cell on a board of 14 by 14, and the next can follow {pace} steps later.",
    ),
    "top": Said(
        Part(id="pad", name="walking", parameters={"speed": (1, 3, 0.5)}),
        "The pad moves the {hero} {speed} pixels a step in four directions.",
    ),
    "side": Said(
        Part(id="pad", name="walking", parameters={"speed": (1, 2, 0.5), "height": (14, 22, 2), "ledges": (4, 7, 1)}),
        "Left and right walk {speed} pixels a step, up jumps {height} pixels high, and down drops through the thin "
        "ledges, of which {ledges} hang above the floor.",
    ),
}


class Deck(Generic[_Kind]):
    """A pool that is dealt out in random order, all of it once before anything twice, as far as entries fit."""

    def __init__(self, entries: Iterable[_Kind], rng: random.Random) -> None:
        self._all = list(entries)
        self._left: list[_Kind] = []
        self._rng = rng

    def take(self, fits: Callable[[_Kind], bool] = lambda _: True) -> _Kind:
        """The next entry that fits. Raises LookupError where none in the whole pool does."""
        for _ in range(2):
            for place in range(len(self._left) - 1, -1, -1):
                if fits(self._left[place]):
                    return self._left.pop(place)
            # What does not fit this time stays, and is not put in a second time.
            again = [entry for entry in self._all if fits(entry)]
            self._rng.shuffle(again)
            self._left += again
        raise LookupError("nothing in the pool fits")


class Strategy(ABC):
    """A way to choose ingredients. `capacity` is in how many ways it can; two drafts may be the same."""

    name: str

    def __init__(self, pools: Pools, rng: random.Random) -> None:
        self.pools, self.rng = pools, rng
        self.themes: Deck[Theme] = Deck(pools.themes.values(), rng)

    @property
    @abstractmethod
    def capacity(self) -> int:
        """How many different sets of ingredients there are."""

    @abstractmethod
    def draw(self) -> Draft:
        """The next draft."""


class GenreBlend(Strategy):
    """Three genres: one gives controls, loop and goal, two each lend it a rule. Of four blends one is of a mashup,
    whose rule and goal take the place of what its genres would lend.
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
            [Said(host, host.pad)],
            [Said(host, host.loop), *(Said(guest, guest.lend) for guest in guests)],
            Said(host, host.win),
            Said(host, host.loss),
            host.objects,
        )

    def _mashup(self) -> Draft:
        mashup = self._mashups.take()
        genres = [self.pools.genres[name] for name in mashup.genres]
        host, theme = genres[0], self.themes.take()
        lent: list[Said] = []
        besides = ""
        if len(genres) < 3:
            guest = self._guest(host, set(mashup.genres))
            genres.append(guest)
            lent = [Said(guest, guest.lend)]
            besides = f", with a rule of {guest.name} besides"
        blended = " and ".join(self.pools.genres[name].name for name in mashup.genres[1:])
        return Draft(
            self.name,
            mashup.name + besides.replace(" a rule of", "").replace(" besides", ""),
            f"This is {mashup.name}: the genre {host.name} mixed with {blended}{besides}.",
            (f"theme:{theme.id}", f"mashup:{mashup.id}", *(f"genre:{genre.id}" for genre in genres)),
            theme,
            host.views[0],
            [Said(host, host.pad)],
            [Said(host, host.loop), Said(mashup, mashup.rule), *lent],
            Said(mashup, mashup.win),
            Said(mashup, mashup.loss),
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
            [Said(mechanic, mechanic.rule) for mechanic in chosen if mechanic.control != "world"],
            [Said(mechanic, mechanic.rule) for mechanic in chosen if mechanic.control == "world"],
            Said(winning, winning.win),
            Said(losing, losing.loss),
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
        controls, rules = [] if core.control == "pad" else [MOVES[view]], [Said(twist, twist.rule)]
        (rules if core.control == "world" else controls).insert(
            1 if core.control == "button" else 0, Said(core, core.rule)
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
            Said(core, core.win),
            Said(core, core.loss),
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
            [Said(idea, idea.pad)],
            [Said(idea, idea.rule), Said(twist, twist.rule)],
            Said(idea, idea.win),
            Said(idea, idea.loss),
        )


STRATEGIES: tuple[type[Strategy], ...] = (GenreBlend, Mechanical, Thematic, Experimental)


def _goes_with(mechanic: Mechanic, chosen: list[Mechanic]) -> bool:
    """Whether a mechanic can be played together with those, the first of which is the pad's."""
    if mechanic in chosen or chosen[0].views[0] not in mechanic.views:
        return False
    return mechanic.group is None or all(mechanic.group != other.group for other in chosen)


def _by_groups(mechanics: list[Mechanic], number: int) -> Counter[tuple[str, ...]]:
    """How many choices of so many there are, by the groups that are taken; none has a group twice."""
    choices = itertools.combinations(mechanics, number)
    taken = (tuple(mechanic.group for mechanic in chosen if mechanic.group) for chosen in choices)
    return Counter(groups for groups in taken if len(set(groups)) == len(groups))


def _twists(twist: Twist, core: Mechanic | Experiment) -> bool:
    """Whether a twist means anything in a game of this core."""
    if not set(twist.views) & set(core.views):
        return False
    texts = [core.rule, core.pad] if isinstance(core, Experiment) else [core.rule]
    if twist.needs == "lives":
        return takes_lives(Said(core, text) for text in texts)
    return twist.needs is None or buttons(*texts) > 0
