"""What the report says about copies and diversity: clusters of environments, and how many different ones there are."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

import msgspec

from envcraft.corpus import likeness
from envcraft.corpus.likeness import Cluster, Diversity
from envcraft.corpus.store import Store

#: The layer that needs a package of its own, and that package.
_NEAR, _PACKAGE = "near", "rensa"
#: So many members of a cluster are named.
_NAMED = 12


class Layer(msgspec.Struct, frozen=True):
    """One layer: environments that have a key in it, its clusters, and the environments in these."""

    name: str
    keyed: int
    clusters: int
    members: int
    diversity: Diversity


class Alike(msgspec.Struct):
    """The copies in a corpus. `clusters` are over all layers, the largest first, with the numbers of their members."""

    layers: list[Layer]
    clusters: list[tuple[Cluster, list[int]]]
    of: dict[int, int]

    @property
    def copies(self) -> int:
        """Environments that are left out where one of each cluster is kept."""
        return sum(len(numbers) - 1 for _, numbers in self.clusters)

    def cluster(self, number: int) -> int | None:
        """The cluster of an environment, counted from 1."""
        return self.of.get(number)

    def others(self, number: int) -> Iterator[tuple[int, str]]:
        """Numbers and names of what is in an environment's cluster besides, the best first, `_NAMED` at the most."""
        place = self.of.get(number)
        if place is not None:
            cluster, numbers = self.clusters[place - 1]
            found = [item for item in zip(numbers, cluster.members, strict=True) if item[0] != number]
            yield from found[:_NAMED]


def compared() -> list[str]:
    """The layers that can be compared with what is installed."""
    found = importlib.util.find_spec(_PACKAGE) is not None
    return [layer for layer in likeness.LAYERS if found or layer != _NEAR]


def alike(store: Store) -> Alike:
    """Compare all environments. Raises CorpusDamaged."""
    layers = compared()
    numbers = {
        name: number for number, (name,) in enumerate(store.db.execute("SELECT name FROM environments ORDER BY name"))
    }
    found = likeness.clusters(store, layers)
    largest = sorted(found.clusters, key=lambda cluster: (-len(cluster.members), cluster.members[0]))
    clusters = [(cluster, [numbers[name] for name in cluster.members]) for cluster in largest]
    diversities = {told.layer: told for told in likeness.diversities(store, layers)}
    rows = [
        Layer(name, layer.keyed, len(layer.clusters), sum(map(len, layer.clusters)), diversities[name])
        for name, layer in found.layers.items()
    ]
    of = {number: place for place, (_, members) in enumerate(clusters, 1) for number in members}
    return Alike(rows, clusters, of)
