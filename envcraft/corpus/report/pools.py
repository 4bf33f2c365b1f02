"""The section of the report on pools: how many of their ingredients the concepts and the environments have."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

from envcraft.corpus.report.data import Entry
from envcraft.corpus.report.history import History, ingredients
from envcraft.corpus.store import Store, generation
from envcraft.model.pool import Pool
from envcraft.model.verdict import Outcome
from envcraft.registry import offered
from envcraft.text import one_line


class PoolRow(NamedTuple):
    """One pool. An ingredient that the pool does not have counts nowhere.

    Attributes:
        kind: of its ingredients.
        size: how many ingredients it has.
        concepts: how many of them a concept has.
        environments: how many of them an environment has.
        passed: how many of them an environment that passes has.
        most: the ingredient of most environments; empty if there is none.
        times: of how many.
        missing: the ingredients that no environment that passes has.
    """

    kind: str
    size: int
    concepts: int
    environments: int
    passed: int
    most: str
    times: int
    missing: list[str]


class PoolCoverage:
    """Counts ingredients.

    Args:
        store: the corpus.
    """

    def __init__(self, store: Store) -> None:
        self._concepts = {found for data in generation.concept_data(store) for found in ingredients(data)}
        self._environments: Counter[tuple[str, str]] = Counter()
        self._passed: set[tuple[str, str]] = set()

    def add(self, entry: Entry, known: History) -> None:
        """Count an environment with its history."""
        found = set(ingredients(known.data))
        self._environments.update(found)
        if entry.outcome == Outcome.PASS.value:
            self._passed |= found

    def rows(self) -> list[PoolRow]:
        """A row for each pool; empty if no concept has an ingredient. An unknown pool is what is used of it."""
        if not self._concepts:
            return []
        pools = {pool.name: pool for pool in offered("envcraft_pools")}
        for kind in sorted({kind for kind, _ in self._concepts} - pools.keys()):
            pools[kind] = Pool(kind, tuple(sorted(name for other, name in self._concepts if other == kind)))
        return [self._row(pool) for pool in pools.values()]

    def _row(self, pool: Pool) -> PoolRow:
        entries = [(pool.name, entry) for entry in pool.entries]
        most = max(entries, key=lambda entry: self._environments[entry], default=("", ""))
        times = self._environments[most]
        return PoolRow(
            one_line(pool.name),
            len(entries),
            sum(entry in self._concepts for entry in entries),
            sum(entry in self._environments for entry in entries),
            sum(entry in self._passed for entry in entries),
            one_line(most[1]) if times else "",
            times,
            [one_line(name) for kind, name in entries if (kind, name) not in self._passed],
        )
