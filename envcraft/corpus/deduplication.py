"""Which environments of a corpus are duplicates, and how diverse they are, by the layers of :mod:`envcraft.similarity`.

A store that is open for writing keeps the keys of sources, so each is computed once; the behaviour of environments is
part of the reports of their audits.
"""

from __future__ import annotations

import random
import statistics
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import msgspec

from envcraft.corpus.store import Environment, Store, environments, keys, verdicts
from envcraft.similarity import behavioural, diversity, exact, near, structural
from envcraft.similarity.groups import Groups

_OF_SOURCES: dict[str, tuple[int, Callable[[bytes], bytes | None]]] = {
    "exact": (exact.VERSION, exact.key),
    "structural": (structural.VERSION, structural.key),
    "near": (near.VERSION, near.key),
}
LAYERS = (*_OF_SOURCES, "behavioural")
#: Sources whose keys are stored in one transaction.
_BATCH = 200
#: Samples that a Vendi score is the median of.
_DRAWS = 5


class Layer(msgspec.Struct):
    """The result of one layer: how many environments have a key in it, and the clusters, the best member first."""

    keyed: int
    clusters: list[list[str]]


class Cluster(msgspec.Struct):
    """Duplicates, the best first, and the layers that connect them."""

    members: list[str]
    layers: list[str]


class Duplicates(msgspec.Struct):
    """The clusters of a corpus with so many `environments`: by layer, and over all requested layers."""

    environments: int
    layers: dict[str, Layer]
    clusters: list[Cluster]


class Diversity(msgspec.Struct):
    """The Vendi score of one layer.

    Attributes:
        layer: the layer.
        environments: how many environments have a key in the layer.
        sample: how many environments the score is of.
        score: the score; the median over several samples if there are more environments than the sample size.
        least: the lowest score of these samples.
        most: the highest score of these samples.
    """

    layer: str
    environments: int
    sample: int
    score: float
    least: float
    most: float


def clusters(
    store: Store,
    layers: Sequence[str] = LAYERS,
    threshold: float = near.THRESHOLD,
    members: Sequence[Environment] | None = None,
) -> Duplicates:
    """Find the duplicates among environments.

    Sources with an explicitly chosen class are only duplicates by their text if the classes have the same name.

    Args:
        store: the corpus.
        layers: the layers to compare by.
        threshold: the Jaccard index from which sources are near-duplicates.
        members: what to compare, the best first; by default all environments.

    Raises:
        UsageError: if the layer `near` is requested and rensa is not installed.
        CorpusDamaged: if a source is missing or has changed.
    """
    members = environments.best_first(store) if members is None else members
    by_source = _source_keys(store, {member.source for member in members}, layers)
    found: dict[str, Layer] = {}
    whole = Groups(len(members))
    by_layer: dict[str, list[list[int]]] = {}
    for layer in layers:
        if layer == "near":
            keyed, groups = _near(members, by_source[layer], threshold)
        elif layer == "behavioural":
            keyed, groups = _behavioural(store, members)
        else:
            keyed, groups = _equal([by_source[layer][member.source] for member in members], members)
        by_layer[layer] = [group for group in groups.all() if len(group) > 1]
        for first, *others in by_layer[layer]:
            for other in others:
                whole.join(first, other)
        found[layer] = Layer(keyed, [[members[number].name for number in group] for group in by_layer[layer]])
    clustered = {layer: {number for group in groups for number in group} for layer, groups in by_layer.items()}
    together = [
        Cluster(
            [members[number].name for number in group], [layer for layer in layers if clustered[layer] & set(group)]
        )
        for group in whole.all()
        if len(group) > 1
    ]
    return Duplicates(len(members), found, together)


def groups_of(store: Store, layers: Sequence[str] = LAYERS, threshold: float = near.THRESHOLD) -> list[list[str]]:
    """Partition the environments so that duplicates, and environments with the same source, are in one group.

    Args and exceptions are those of :func:`clusters`.
    """
    return grouped(store, clusters(store, layers, threshold))


def grouped(store: Store, duplicates: Duplicates) -> list[list[str]]:
    """The groups of :func:`groups_of` for duplicates that were found before."""
    members = environments.best_first(store)
    numbers = {member.name: number for number, member in enumerate(members)}
    groups = Groups(len(members))
    for cluster in duplicates.clusters:
        for name in cluster.members:
            groups.join(numbers[cluster.members[0]], numbers[name])
    first: dict[str, int] = {}
    for number, member in enumerate(members):
        groups.join(first.setdefault(member.source, number), number)
    return [[members[number].name for number in group] for group in groups.all()]


def diversities(store: Store, layers: Sequence[str] = LAYERS, sample: int = 1000, seed: int = 0) -> list[Diversity]:
    """The Vendi score of a corpus by each layer.

    Args:
        store: the corpus.
        layers: the layers to compare by.
        sample: the sample size of the layers `near` and `behavioural`.
        seed: the seed of the samples.

    Raises:
        UsageError: if the layer `near` is requested and rensa is not installed.
        CorpusDamaged: if a source is missing or has changed.
    """
    members = environments.best_first(store)
    by_source = _source_keys(store, {member.source for member in members}, layers)
    found = []
    for layer in layers:
        if layer == "near":
            sources = sorted(source for source, key in by_source[layer].items() if key is not None)
            left = near.own([near.shingles(by_source[layer][source] or b"") for source in sources])
            own = {source: rest for source, rest in zip(sources, left, strict=True) if rest is not None}
            sets = [own[member.source] for member in members if member.source in own]
            found.append(_sampled(layer, sets, near.kernel, sample, seed))
        elif layer == "behavioural":
            series = [known for known in _series(store, members) if known is not None]
            found.append(_sampled(layer, series, behavioural.kernel, sample, seed))
        else:
            kinds = [(key, env) for _, source, env in members if (key := by_source[layer][source]) is not None]
            score = diversity.vendi_of_kinds(kinds)
            found.append(Diversity(layer, len(kinds), len(kinds), score, score, score))
    return found


def _source_keys(store: Store, sources: set[str], layers: Sequence[str]) -> dict[str, dict[str, bytes | None]]:
    """The keys of sources by layer; those that are not stored are computed."""
    wanted = {layer: _OF_SOURCES[layer] for layer in layers if layer in _OF_SOURCES}
    found = {
        layer: {source: key for source, key in keys.stored(store, layer, version).items() if source in sources}
        for layer, (version, _) in wanted.items()
    }
    missing = sorted(source for source in sources if any(source not in known for known in found.values()))
    for start in range(0, len(missing), _BATCH):
        rows = []
        for source in missing[start : start + _BATCH]:
            data = store.source(source)
            for layer, (version, make) in wanted.items():
                found[layer][source] = key = make(data)
                rows.append((source, layer, version, key))
        if store.writes:
            keys.keep(store, rows)
    return found


def _equal(found: Sequence[Hashable], members: Sequence[Environment]) -> tuple[int, Groups]:
    """How many members have a key, and the groups of those with the same key and the same chosen class."""
    groups = Groups(len(members))
    first: dict[Hashable, int] = {}
    for number, (key, member) in enumerate(zip(found, members, strict=True)):
        if key is not None:
            groups.join(first.setdefault((key, member.env_class), number), number)
    return sum(key is not None for key in found), groups


def _near(members: Sequence[Environment], found: dict[str, bytes | None], threshold: float) -> tuple[int, Groups]:
    sources = list(dict.fromkeys(member.source for member in members if found[member.source] is not None))
    left = near.own([near.shingles(found[source] or b"") for source in sources])
    judged = [(source, rest) for source, rest in zip(sources, left, strict=True) if rest is not None]
    similar = Groups(len(judged))
    for one, two in near.pairs([rest for _, rest in judged], threshold, similar):
        similar.join(one, two)
    group_of = {judged[number][0]: place for place, group in enumerate(similar.all()) for number in group}
    return _equal([group_of.get(member.source) for member in members], members)


def _behavioural(store: Store, members: Sequence[Environment]) -> tuple[int, Groups]:
    series = _series(store, members)
    numbers = [number for number, known in enumerate(series) if known is not None]
    groups = Groups(len(members))
    for one, two in behavioural.pairs([known for known in series if known is not None]):
        groups.join(numbers[one], numbers[two])
    return len(numbers), groups


class _Fingerprint(msgspec.Struct):
    """The only part of a report that is decoded."""

    fingerprint: str = ""


def _series(store: Store, members: Sequence[Environment]) -> list[behavioural.Series | None]:
    """The recorded behaviour of each member, under the action script that most members have in common."""
    known: dict[tuple[str, str], dict[bytes, behavioural.Series]] = {}
    decoder = msgspec.json.Decoder(_Fingerprint)
    for source, env_class, report in verdicts.reports(store):
        series = behavioural.read(decoder.decode(report).fingerprint)
        if series is not None:
            known.setdefault((source, env_class), {})[series.script] = series
    by_member = [known.get((member.source, member.env_class), {}) for member in members]
    scripts = Counter(script for found in by_member for script in found)
    order = sorted(scripts, key=lambda script: (-scripts[script], script))
    return [next((found[script] for script in order if script in found), None) for found in by_member]


def _sampled(layer: str, things: Sequence[Any], kernel: Callable[[Any], Any], sample: int, seed: int) -> Diversity:
    draws = _DRAWS if len(things) > sample else 1
    scores = []
    for draw in range(draws):
        drawn = random.Random(seed * _DRAWS + draw).sample(things, sample) if draws > 1 else things
        scores.append(diversity.vendi(kernel(drawn)))
    count = min(sample, len(things))
    return Diversity(layer, len(things), count, statistics.median(scores), min(scores), max(scores))
