"""Which environments of a corpus are the same one, and how many different ones there are, by the layers of
:mod:`envcraft.similarity`.

Keys of sources are kept in the corpus by a store that writes, and made only once; how an environment behaves is in the
reports of its audits.
"""

from __future__ import annotations

import random
import statistics
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import msgspec

from envcraft.corpus.store import Store
from envcraft.similarity import behavioural, diversity, exact, near, structural
from envcraft.similarity.groups import Groups

_OF_SOURCES: dict[str, tuple[int, Callable[[bytes], bytes | None]]] = {
    "exact": (exact.VERSION, exact.key),
    "structural": (structural.VERSION, structural.key),
    "near": (near.VERSION, near.key),
}
LAYERS = (*_OF_SOURCES, "behavioural")
#: Environments, the best first: one that passes before one that fails, before what could not be judged, before what was
#: not; then fewer errors, fewer warnings, the one that was added first, the name.
_BEST_FIRST = (
    "SELECT name, environments.source, environments.class FROM environments "
    "LEFT JOIN verdicts ON verdicts.id = environments.verdict AND verdicts.source = environments.source "
    "AND verdicts.class = environments.class "
    "LEFT JOIN findings ON findings.verdict = verdicts.id GROUP BY name ORDER BY "
    "CASE verdicts.verdict WHEN 'pass' THEN 0 WHEN 'fail' THEN 1 WHEN 'error' THEN 2 ELSE 3 END, "
    "coalesce(sum(severity = 'error'), 0), coalesce(sum(severity = 'warning'), 0), added, name"
)
#: Sources whose keys are written down together.
_BATCH = 200
_DRAWS = 5


class Layer(msgspec.Struct):
    """What one layer says: how many environments have a key in it, and the clusters, the best of each first."""

    keyed: int
    clusters: list[list[str]]


class Cluster(msgspec.Struct):
    """Environments that layers connect, the best first, and those layers."""

    members: list[str]
    layers: list[str]


class Likeness(msgspec.Struct):
    """The clusters of a corpus of so many `environments`, by layer and over all layers that were asked for."""

    environments: int
    layers: dict[str, Layer]
    clusters: list[Cluster]


class Diversity(msgspec.Struct):
    """The Vendi score by one layer.

    Attributes:
        environments: those that have a key in the layer.
        sample: of how many the score is.
        score: of all of them; where they are more than a sample, the median over several samples.
        least, most: over these samples.
    """

    layer: str
    environments: int
    sample: int
    score: float
    least: float
    most: float


class Member(NamedTuple):
    """A source under a name: the SHA-256 in hex, and the class where it was picked."""

    name: str
    source: str
    env_class: str


def clusters(
    store: Store,
    layers: Sequence[str] = LAYERS,
    threshold: float = near.THRESHOLD,
    members: Sequence[Member] | None = None,
) -> Likeness:
    """Find what is the same among `members`, by default the environments. `threshold` is the Jaccard index from which
    on sources are near-duplicates.

    Environments of different classes that were picked by name are the same only by what they do.
    Raises UsageError without rensa, CorpusDamaged.
    """
    members = _members(store) if members is None else members
    keys = _source_keys(store, {member.source for member in members}, layers)
    found: dict[str, Layer] = {}
    whole = Groups(len(members))
    by_layer: dict[str, list[list[int]]] = {}
    for layer in layers:
        if layer == "near":
            keyed, groups = _near(members, keys[layer], threshold)
        elif layer == "behavioural":
            keyed, groups = _behavioural(store, members)
        else:
            keyed, groups = _equal([keys[layer][member.source] for member in members], members)
        by_layer[layer] = [group for group in groups.all() if len(group) > 1]
        for first, *others in by_layer[layer]:
            for other in others:
                whole.join(first, other)
        found[layer] = Layer(keyed, [[members[number].name for number in group] for group in by_layer[layer]])
    said = {layer: {number for group in groups for number in group} for layer, groups in by_layer.items()}
    together = [
        Cluster([members[number].name for number in group], [layer for layer in layers if said[layer] & set(group)])
        for group in whole.all()
        if len(group) > 1
    ]
    return Likeness(len(members), found, together)


def groups_of(store: Store, layers: Sequence[str] = LAYERS, threshold: float = near.THRESHOLD) -> list[list[str]]:
    """Every environment in exactly one group: its cluster, together with what shares a source with it, or itself."""
    return grouped(store, clusters(store, layers, threshold))


def grouped(store: Store, found: Likeness) -> list[list[str]]:
    """The groups of :func:`groups_of` from the clusters that were found."""
    members = _members(store)
    numbers = {member.name: number for number, member in enumerate(members)}
    groups = Groups(len(members))
    for cluster in found.clusters:
        for name in cluster.members:
            groups.join(numbers[cluster.members[0]], numbers[name])
    first: dict[str, int] = {}
    for number, member in enumerate(members):
        groups.join(first.setdefault(member.source, number), number)
    return [[members[number].name for number in group] for group in groups.all()]


def diversities(store: Store, layers: Sequence[str] = LAYERS, sample: int = 1000, seed: int = 0) -> list[Diversity]:
    """How many different environments there are, by each layer. Raises UsageError without rensa, CorpusDamaged."""
    members = _members(store)
    keys = _source_keys(store, {member.source for member in members}, layers)
    found = []
    for layer in layers:
        if layer == "near":
            sources = sorted(source for source, stored in keys[layer].items() if stored is not None)
            left = near.own([near.shingles(keys[layer][source] or b"") for source in sources])
            own = {source: rest for source, rest in zip(sources, left, strict=True) if rest is not None}
            sets = [own[member.source] for member in members if member.source in own]
            found.append(_sampled(layer, sets, near.kernel, sample, seed))
        elif layer == "behavioural":
            series = [known for known in _series(store, members) if known is not None]
            found.append(_sampled(layer, series, behavioural.kernel, sample, seed))
        else:
            kinds = [(key, env) for _, source, env in members if (key := keys[layer][source]) is not None]
            score = diversity.vendi_of_kinds(kinds)
            found.append(Diversity(layer, len(kinds), len(kinds), score, score, score))
    return found


def _members(store: Store) -> list[Member]:
    return [Member(*row) for row in store.db.execute(_BEST_FIRST)]


def _source_keys(store: Store, sources: set[str], layers: Sequence[str]) -> dict[str, dict[str, bytes | None]]:
    """The keys of sources by layer, those that were kept and the others."""
    wanted = {layer: _OF_SOURCES[layer] for layer in layers if layer in _OF_SOURCES}
    keys: dict[str, dict[str, bytes | None]] = {
        layer: {
            source: key
            for source, key in store.db.execute(
                "SELECT source, key FROM keys WHERE layer = ? AND version = ?", (layer, version)
            )
            if source in sources
        }
        for layer, (version, _) in wanted.items()
    }
    missing = sorted(source for source in sources if any(source not in known for known in keys.values()))
    for start in range(0, len(missing), _BATCH):
        rows = []
        for source in missing[start : start + _BATCH]:
            data = store.source(source)
            for layer, (version, make) in wanted.items():
                keys[layer][source] = key = make(data)
                rows.append((source, layer, version, key))
        if store.writes:
            with store.transaction():
                store.db.executemany(
                    "INSERT OR REPLACE INTO keys (source, layer, version, key) VALUES (?, ?, ?, ?)", rows
                )
    return keys


def _equal(keys: Sequence[Hashable], members: Sequence[Member]) -> tuple[int, Groups]:
    """Groups of those with one key, and one class where it was picked."""
    groups = Groups(len(members))
    first: dict[Hashable, int] = {}
    for number, (key, member) in enumerate(zip(keys, members, strict=True)):
        if key is not None:
            groups.join(first.setdefault((key, member.env_class), number), number)
    return sum(key is not None for key in keys), groups


def _near(members: Sequence[Member], keys: dict[str, bytes | None], threshold: float) -> tuple[int, Groups]:
    sources = list(dict.fromkeys(member.source for member in members if keys[member.source] is not None))
    left = near.own([near.shingles(keys[source] or b"") for source in sources])
    judged = [(source, rest) for source, rest in zip(sources, left, strict=True) if rest is not None]
    alike = Groups(len(judged))
    for one, two in near.pairs([rest for _, rest in judged], threshold, alike):
        alike.join(one, two)
    group_of = {judged[number][0]: place for place, group in enumerate(alike.all()) for number in group}
    return _equal([group_of.get(member.source) for member in members], members)


def _behavioural(store: Store, members: Sequence[Member]) -> tuple[int, Groups]:
    series = _series(store, members)
    numbers = [number for number, known in enumerate(series) if known is not None]
    groups = Groups(len(members))
    for one, two in behavioural.pairs([known for known in series if known is not None]):
        groups.join(numbers[one], numbers[two])
    return len(numbers), groups


class _Fingerprint(msgspec.Struct):
    """All that is wanted of a report."""

    fingerprint: str = ""


def _series(store: Store, members: Sequence[Member]) -> list[behavioural.Series | None]:
    """What each environment did, under the actions that most of them were given."""
    known: dict[tuple[str, str], dict[bytes, behavioural.Series]] = {}
    decoder = msgspec.json.Decoder(_Fingerprint)
    for source, env_class, report in store.db.execute("SELECT source, class, report FROM verdicts ORDER BY id"):
        series = behavioural.read(decoder.decode(report).fingerprint)
        if series is not None:
            known.setdefault((source, env_class), {})[series.script] = series
    told = [known.get((member.source, member.env_class), {}) for member in members]
    scripts = Counter(script for found in told for script in found)
    order = sorted(scripts, key=lambda script: (-scripts[script], script))
    return [next((found[script] for script in order if script in found), None) for found in told]


def _sampled(layer: str, things: Sequence[Any], kernel: Callable[[Any], Any], sample: int, seed: int) -> Diversity:
    draws = _DRAWS if len(things) > sample else 1
    scores = []
    for draw in range(draws):
        drawn = random.Random(seed * _DRAWS + draw).sample(things, sample) if draws > 1 else things
        scores.append(diversity.vendi(kernel(drawn)))
    count = min(sample, len(things))
    return Diversity(layer, len(things), count, statistics.median(scores), min(scores), max(scores))
