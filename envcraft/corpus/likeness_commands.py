"""``envcraft corpus dedup``, ``diversity`` and ``split``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from envcraft import __version__
from envcraft.corpus.store import opened
from envcraft.errors import UsageError
from envcraft.reports import one_line, plural
from envcraft.verdict import SCHEMA, plain

if TYPE_CHECKING:
    from envcraft.corpus.likeness import Cluster, Likeness

#: So many clusters, and so many names of each, are shown to people.
_SHOWN = 10
_NAMES = ("exact", "structural", "near", "behavioural")

_CORPUS = click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
_LAYERS = click.option(
    "--layer",
    "layers",
    type=click.Choice(_NAMES),
    multiple=True,
    help="Only this layer; may be given several times.  [default: all four]",
)
_THRESHOLD = click.option(
    "--threshold",
    type=click.FloatRange(0.1, 1),
    default=0.7,
    show_default=True,
    help="The Jaccard index from which on sources are near-duplicates.",
)
_FORMAT = click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)


@click.command()
@_CORPUS
@_LAYERS
@_THRESHOLD
@click.option("--keep-best", is_flag=True, help="Remove all of each cluster but its best.")
@_FORMAT
def dedup(corpus: Path, layers: tuple[str, ...], threshold: float, keep_best: bool, form: str) -> None:
    """Tell which environments are the same: exact, structural, near and behavioural copies, and clusters over all.

    The best of a cluster passes rather than fails, has fewer errors, then fewer warnings, and was added first. Nothing
    is removed without --keep-best.
    """
    from envcraft.corpus.likeness import clusters

    with opened(corpus, write=keep_best) as store:
        if keep_best and store.follows_folder:
            raise UsageError(f"{corpus} follows a folder: remove files there; without --keep-best they are named")
        found = clusters(store, _chosen(layers), threshold)
        removed = [name for cluster in found.clusters for name in cluster.members[1:]] if keep_best else []
        for name in removed:
            store.remove(name)
    if form == "json":
        told = {"environments": found.environments, "threshold": threshold, "layers": found.layers}
        _write({**told, "clusters": [_told(cluster) for cluster in found.clusters], "removed": removed})
    else:
        _write_clusters(found, keep_best)


@click.command()
@_CORPUS
@_LAYERS
@click.option(
    "--sample",
    type=click.IntRange(2, 5000),
    default=1000,
    show_default=True,
    help="Of so many the near and behavioural scores are taken, where there are more.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Picks the samples.")
@_FORMAT
def diversity(corpus: Path, layers: tuple[str, ...], sample: int, seed: int, form: str) -> None:
    """Tell how many different environments there are, by layer: the Vendi score, from 1 (all alike) to their number.

    A score grows with the number of environments: compare scores of one n.
    """
    from envcraft.corpus.likeness import diversities

    with opened(corpus) as store:
        found = diversities(store, _chosen(layers), sample, seed)
    if form == "json":
        _write({"seed": seed, "diversity": found})
        return
    for measured in found:
        if not measured.environments:
            click.echo(f"{measured.layer:11}  no environment has a key; `envcraft corpus dedup {corpus}` tells more")
            continue
        told = f"{measured.layer:11}  {measured.score:,.1f} of {plural(measured.sample, 'environment')}"
        if measured.sample < measured.environments:
            spread = f"{measured.least:,.1f} to {measured.most:,.1f} in five samples"
            told += f", {spread} of the {measured.environments:,} there are"
        click.echo(told)


@click.command()
@_CORPUS
@click.option("--fractions", metavar="A,B,...", help="The share of each split, such as 0.8,0.1,0.1.")
@click.option("--folds", type=click.IntRange(2), metavar="K", help="K splits of one size, in place of --fractions.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Same seed, same splits.")
@_LAYERS
@_THRESHOLD
def split(
    corpus: Path, fractions: str | None, folds: int | None, seed: int, layers: tuple[str, ...], threshold: float
) -> None:
    """Write splits that never cut a cluster of `dedup`, as JSON: no environment has a copy in another split."""
    from envcraft.corpus.splits import corpus_splits

    shares = _shares(fractions, folds)
    with opened(corpus) as store:
        found = corpus_splits(store, shares, seed, _chosen(layers), threshold)
    told = [{"fraction": share, "environments": names} for share, names in zip(shares, found, strict=True)]
    _write({"seed": seed, "layers": _chosen(layers), "threshold": threshold, "splits": told})


def _chosen(layers: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in _NAMES if not layers or name in layers)


def _shares(fractions: str | None, folds: int | None) -> list[float]:
    if (fractions is None) == (folds is None):
        raise UsageError("name either --fractions, such as 0.8,0.1,0.1, or --folds, such as 5")
    if folds is not None:
        return [1 / folds] * folds
    try:
        return [float(part) for part in str(fractions).split(",")]
    except ValueError:
        raise UsageError(f"--fractions {fractions} are no numbers; write them like 0.8,0.1,0.1") from None


def _told(cluster: Cluster) -> dict[str, Any]:
    return {"best": cluster.members[0], "others": cluster.members[1:], "layers": cluster.layers}


def _write(told: dict[str, Any]) -> None:
    whole = {"schema": SCHEMA, "envcraft": __version__, **told}
    click.echo(msgspec.json.format(msgspec.json.encode(plain(whole)), indent=2))


def _write_clusters(found: Likeness, removed: bool) -> None:
    for name, layer in found.layers.items():
        extra = sum(len(members) - 1 for members in layer.clusters)
        lacking = found.environments - layer.keyed
        words = f"{plural(len(layer.clusters), 'cluster')}, {extra:,} more than their best"
        click.echo(f"{name:11}  {words}" + (f"; {lacking:,} without a key" if lacking else ""))
    extra = sum(len(cluster.members) - 1 for cluster in found.clusters)
    done = "removed" if removed else "not the best of theirs"
    click.echo(
        f"{plural(found.environments, 'environment')}: {plural(len(found.clusters), 'cluster')}, {extra:,} {done}"
    )
    # All names where they are gone.
    shown = found.clusters if removed else found.clusters[:_SHOWN]
    for cluster in shown:
        names = cluster.members[1:] if removed else cluster.members[1 : _SHOWN + 1]
        click.echo(f"  {one_line(cluster.members[0])}  ({', '.join(cluster.layers)})")
        for name in names:
            click.echo(f"    {'removed ' if removed else ''}{one_line(name)}")
        if len(names) < len(cluster.members) - 1:
            click.echo(f"    and {len(cluster.members) - 1 - len(names):,} more")
    if len(shown) < len(found.clusters):
        click.echo(f"  and {plural(len(found.clusters) - len(shown), 'more cluster')}; --format json has them all")
