"""The section of the report on duplicates and diversity."""

from __future__ import annotations

import importlib.util

import msgspec

from envcraft.corpus import deduplication
from envcraft.corpus.deduplication import Cluster, Diversity
from envcraft.corpus.store import Store, environments

#: The layer that needs an optional package, and that package.
_NEAR, _PACKAGE = "near", "rensa"
#: How many other members of a cluster are named.
_SHOWN = 12


class LayerRow(msgspec.Struct, frozen=True):
    """One layer: environments that have a key in it, its clusters, and the environments in the clusters."""

    name: str
    keyed: int
    clusters: int
    members: int
    diversity: Diversity


class DuplicateSummary(msgspec.Struct):
    """The duplicates of a corpus.

    Attributes:
        layers: one row for each layer.
        clusters: over all layers, the largest first, each with the numbers of its members.
        of: the cluster of each environment by number, counted from 1.
    """

    layers: list[LayerRow]
    clusters: list[tuple[Cluster, list[int]]]
    of: dict[int, int]

    @property
    def redundant(self) -> int:
        """How many environments are not the best of their cluster."""
        return sum(len(numbers) - 1 for _, numbers in self.clusters)

    def cluster(self, number: int) -> int | None:
        """The cluster of an environment, counted from 1; None if it has no duplicate."""
        return self.of.get(number)

    def others(self, number: int) -> list[int]:
        """The numbers of an environment's duplicates, the best first, at most 12."""
        place = self.of.get(number)
        found = [] if place is None else self.clusters[place - 1][1]
        return [other for other in found if other != number][:_SHOWN]

    def layers_of(self, number: int) -> list[str]:
        """The layers that connect the cluster of an environment; empty if it has no duplicate."""
        place = self.of.get(number)
        return [] if place is None else self.clusters[place - 1][0].layers


def available_layers() -> list[str]:
    """The layers whose packages are installed."""
    found = importlib.util.find_spec(_PACKAGE) is not None
    return [layer for layer in deduplication.LAYERS if found or layer != _NEAR]


def summarise(store: Store) -> DuplicateSummary:
    """Compare all environments of a corpus.

    Raises:
        CorpusDamaged: if a source is missing or has changed.
    """
    layers = available_layers()
    numbers = {name: number for number, name in enumerate(environments.names(store))}
    found = deduplication.clusters(store, layers)
    largest = sorted(found.clusters, key=lambda cluster: (-len(cluster.members), cluster.members[0]))
    clusters = [(cluster, [numbers[name] for name in cluster.members]) for cluster in largest]
    diversities = {one.layer: one for one in deduplication.diversities(store, layers)}
    rows = [
        LayerRow(name, layer.keyed, len(layer.clusters), sum(map(len, layer.clusters)), diversities[name])
        for name, layer in found.layers.items()
    ]
    of = {number: place for place, (_, members) in enumerate(clusters, 1) for number in members}
    return DuplicateSummary(rows, clusters, of)
