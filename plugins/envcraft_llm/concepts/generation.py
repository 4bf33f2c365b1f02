"""Distinct concepts, as many as are asked for, the same for the same seed."""

from __future__ import annotations

import math
import random
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

from envcraft.errors import UsageError

from .pools import Pools, pools
from .strategies import STRATEGIES, Strategy
from .writing import Concept, Draft, write

#: Which share of the concepts each strategy makes unless told.
SHARES: Mapping[str, float] = {"genre-blend": 0.4, "mechanical": 0.3, "thematic": 0.2, "experimental": 0.1}
#: The kind of ingredient that comes from each pool.
KINDS = {
    "genres": "genre",
    "mechanics": "mechanic",
    "themes": "theme",
    "twists": "twist",
    "mashups": "mashup",
    "experimental": "experimental",
}


def concepts(count: int, seed: int = 0, shares: Mapping[str, float] = SHARES) -> Iterator[Concept]:
    """`count` concepts, no two of the same ingredients and none with another's text; the first of any number have these
    shares as nearly as can be. A larger count, with the same seed and shares, begins with the same concepts.

    Raises UsageError, before the first is made, on a strategy that does not exist, shares that do not sum up to 1, and
    more concepts than there are.
    """
    checked = _checked(shares)
    sources = [
        _Source(strategy(pools(), random.Random(f"{seed} {strategy.name}")), share)
        for strategy in STRATEGIES
        if (share := checked.get(strategy.name, 0)) > 0
    ]
    for source in sources:
        wanted = math.ceil(source.share * count - 1e-6)
        if wanted > source.strategy.capacity:
            raise UsageError(
                f"{count:,} concepts need {wanted:,} of the strategy {source.strategy.name}, which holds "
                f"{source.strategy.capacity:,}: ask for fewer, or give it a smaller share than {source.share:g}"
            )
    return _made(count, sources)


def capacity() -> dict[str, int]:
    """In how many ways each strategy can choose its ingredients."""
    return {strategy.name: strategy(pools(), random.Random(0)).capacity for strategy in STRATEGIES}


@dataclass
class Coverage:
    """What concepts were made of: how many by each strategy, and how often each entry of each pool was used."""

    strategies: Counter[str] = field(default_factory=Counter)
    entries: dict[str, Counter[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known: Pools = pools()
        for pool in KINDS:
            self.entries[pool] = Counter(dict.fromkeys(getattr(known, pool), 0))

    def add(self, concept: Concept) -> None:
        """Count a concept."""
        self.strategies[concept.strategy] += 1
        for ingredient in concept.ingredients:
            kind, _, name = ingredient.partition(":")
            self.entries[_POOLS[kind]][name] += 1


_POOLS = {kind: pool for pool, kind in KINDS.items()}


@dataclass
class _Source:
    """A strategy at work."""

    strategy: Strategy
    share: float
    made: int = 0
    seen: set[tuple[str, ...]] = field(default_factory=set)

    def next(self) -> Draft:
        """A draft of ingredients that were not there together before. Raises UsageError where there are no more."""
        # The rounding of shares may ask for one more than was counted.
        if self.made == self.strategy.capacity:
            raise UsageError(f"the strategy {self.strategy.name} holds {self.made:,} concepts, and all are made")
        draft = self.strategy.draw()
        while draft.ingredients in self.seen:
            draft = self.strategy.draw()
        self.seen.add(draft.ingredients)
        self.made += 1
        return draft


def _made(count: int, sources: Iterable[_Source]) -> Iterator[Concept]:
    known: set[str] = set()
    for number in range(1, count + 1):
        # Whichever is furthest behind its share.
        source = max(sources, key=lambda source: source.share * number - source.made)
        concept = write(source.next(), source.strategy.rng)
        while concept.text_sha256 in known:
            source.made -= 1
            concept = write(source.next(), source.strategy.rng)
        known.add(concept.text_sha256)
        yield concept


def _checked(shares: Mapping[str, float]) -> Mapping[str, float]:
    """Raises UsageError on what are no shares of strategies."""
    names = [strategy.name for strategy in STRATEGIES]
    for name, share in shares.items():
        if name not in names:
            raise UsageError(f"no strategy is called {name}: there are {', '.join(names)}")
        if not 0 <= share <= 1:
            raise UsageError(f"the share of {name} is {share:g}: a share is a number from 0 to 1")
    total = math.fsum(shares.values())
    if abs(total - 1) > 1e-6:
        raise UsageError(f"the shares sum up to {total:g}: they have to sum up to 1, and what is left out has none")
    return shares
