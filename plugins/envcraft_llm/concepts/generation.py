"""Generation of distinct concepts, reproducible by seed."""

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

#: The default share of each strategy.
SHARES: Mapping[str, float] = {"genre-blend": 0.4, "mechanical": 0.3, "thematic": 0.2, "experimental": 0.1}
#: The kind of ingredient by pool.
KINDS = {
    "genres": "genre",
    "mechanics": "mechanic",
    "themes": "theme",
    "twists": "twist",
    "mashups": "mashup",
    "experimental": "experimental",
}


def concepts(count: int, seed: int = 0, shares: Mapping[str, float] = SHARES) -> Iterator[Concept]:
    """Generate concepts with distinct ingredients and distinct texts.

    Every prefix of the sequence has the shares as exactly as possible. A larger count, with the same seed and shares,
    starts with the same concepts.

    Args:
        count: Number of concepts.
        seed: Seed of the random choices.
        shares: Share of each strategy, summing to 1.

    Raises:
        UsageError: Before the first concept, if a strategy does not exist, the shares do not sum to 1, or a strategy
            has too few combinations.
    """
    _check(shares)
    sources = [
        _Source(strategy(pools(), random.Random(f"{seed} {strategy.name}")), share)
        for strategy in STRATEGIES
        if (share := shares.get(strategy.name, 0)) > 0
    ]
    for source in sources:
        wanted = math.ceil(source.share * count - 1e-6)
        if wanted > source.strategy.capacity:
            raise UsageError(
                f"{count:,} concepts need {wanted:,} of the strategy {source.strategy.name}, which has "
                f"{source.strategy.capacity:,}: lower the count, or give it a smaller share than {source.share:g}"
            )
    return _generate(count, sources)


def capacity() -> dict[str, int]:
    """Return the number of combinations of each strategy."""
    return {strategy.name: strategy(pools(), random.Random(0)).capacity for strategy in STRATEGIES}


@dataclass
class Coverage:
    """Usage of the pools: concepts by strategy, and uses of each entry by pool."""

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
    """A strategy, its share, and the combinations that it has drawn."""

    strategy: Strategy
    share: float
    made: int = 0
    seen: set[tuple[str, ...]] = field(default_factory=set)

    def next(self) -> Draft:
        """Draw a new combination. Raises UsageError if there is none left."""
        # Rounding of the shares may need one more combination than the check counted.
        if self.made == self.strategy.capacity:
            raise UsageError(f"the strategy {self.strategy.name} has {self.made:,} concepts, and all are used")
        draft = self.strategy.draw()
        while draft.ingredients in self.seen:
            draft = self.strategy.draw()
        self.seen.add(draft.ingredients)
        self.made += 1
        return draft


def _generate(count: int, sources: Iterable[_Source]) -> Iterator[Concept]:
    known: set[str] = set()
    for number in range(1, count + 1):
        # The strategy that is furthest behind its share.
        source = max(sources, key=lambda source: source.share * number - source.made)
        concept = write(source.next(), source.strategy.rng)
        while concept.text_sha256 in known:
            source.made -= 1
            concept = write(source.next(), source.strategy.rng)
        known.add(concept.text_sha256)
        yield concept


def _check(shares: Mapping[str, float]) -> None:
    """Raises UsageError if the shares are invalid."""
    names = [strategy.name for strategy in STRATEGIES]
    for name, share in shares.items():
        if name not in names:
            raise UsageError(f"there is no strategy {name}; choose from {', '.join(names)}")
        if not 0 <= share <= 1:
            raise UsageError(f"the share of {name} is {share:g}: a share is a number from 0 to 1")
    total = math.fsum(shares.values())
    if abs(total - 1) > 1e-6:
        raise UsageError(f"the shares sum to {total:g}; they must sum to 1")
