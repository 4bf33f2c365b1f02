"""``envcraft corpus dedup``, ``diversity`` and ``split``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from envcraft.corpus.store import open_store
from envcraft.errors import UsageError
from envcraft.model.verdict import SCHEMA, plain
from envcraft.text import one_line, plural
from envcraft.version import __version__

if TYPE_CHECKING:
    from envcraft.corpus.deduplication import Cluster, Duplicates

#: The number of clusters, and of names in each, that the console shows.
_SHOWN = 10
_NAMES = ("exact", "structural", "near", "behavioural")

_CORPUS = click.argument("corpus", metavar="CORPUS", type=click.Path(path_type=Path))
_LAYERS = click.option(
    "--layer",
    "layers",
    type=click.Choice(_NAMES),
    multiple=True,
    help="Compare by this layer only. Repeat the option for several layers.  [default: all four]",
)
_THRESHOLD = click.option(
    "--threshold",
    type=click.FloatRange(0.1, 1),
    default=0.7,
    show_default=True,
    help="The lowest Jaccard index of near-duplicates.",
)
_FORMAT = click.option("--format", "form", type=click.Choice(["console", "json"]), default="console", show_default=True)


@click.command(short_help="Find duplicates.")
@_CORPUS
@_LAYERS
@_THRESHOLD
@click.option("--keep-best", is_flag=True, help="Remove all environments of each cluster except the best.")
@_FORMAT
def dedup(corpus: Path, layers: tuple[str, ...], threshold: float, keep_best: bool, form: str) -> None:
    """Find duplicates by four layers: exact, structural, near and behavioural.

    Environments that any layer connects are one cluster. The best of a cluster is the one that passes, then the one
    with fewer errors, then fewer warnings, then the one that was added first. Without --keep-best nothing is removed.
    """
    from envcraft.corpus.deduplication import clusters

    with open_store(corpus, write=keep_best) as store:
        if keep_best and store.follows_folder:
            raise UsageError(
                f"{corpus} follows a folder: remove files there; without --keep-best this command lists them"
            )
        found = clusters(store, _chosen(layers), threshold)
        removed = [name for cluster in found.clusters for name in cluster.members[1:]] if keep_best else []
        for name in removed:
            store.remove(name)
    if form == "json":
        fields = {"environments": found.environments, "threshold": threshold, "layers": found.layers}
        _write({**fields, "clusters": [_cluster_fields(cluster) for cluster in found.clusters], "removed": removed})
    else:
        _write_clusters(found, keep_best)


@click.command(short_help="Measure diversity.")
@_CORPUS
@_LAYERS
@click.option(
    "--sample",
    type=click.IntRange(2, 5000),
    default=1000,
    show_default=True,
    help="The sample size of the near and behavioural scores.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The seed of the samples.")
@_FORMAT
def diversity(corpus: Path, layers: tuple[str, ...], sample: int, seed: int, form: str) -> None:
    """Measure diversity by layer as a Vendi score.

    The score is 1 if all environments are the same, and their number if all are different. It grows with the number of
    environments, so compare only scores of the same number.
    """
    from envcraft.corpus.deduplication import diversities

    with open_store(corpus) as store:
        found = diversities(store, _chosen(layers), sample, seed)
    if form == "json":
        _write({"seed": seed, "diversity": found})
        return
    for measured in found:
        if not measured.environments:
            click.echo(
                f"{measured.layer:11}  no environment has a key; `envcraft corpus dedup {corpus}` shows the layers"
            )
            continue
        line = f"{measured.layer:11}  {measured.score:,.1f} of {plural(measured.sample, 'environment')}"
        if measured.sample < measured.environments:
            spread = f"{measured.least:,.1f} to {measured.most:,.1f} in five samples"
            line += f", {spread} of {measured.environments:,} environments"
        click.echo(line)


@click.command(short_help="Split without separating duplicates.")
@_CORPUS
@click.option("--fractions", metavar="A,B,...", help="The share of each split, such as 0.8,0.1,0.1.")
@click.option(
    "--folds", type=click.IntRange(2), metavar="K", help="Make K splits of equal size instead of --fractions."
)
@click.option(
    "--by",
    type=click.Choice(["duplicates", "family"]),
    default="duplicates",
    show_default=True,
    help="Keep duplicates, or whole families, in one split. With family and neither --fractions nor --folds, each "
    "family is a split.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The seed of the splits.")
@_LAYERS
@_THRESHOLD
def split(
    corpus: Path,
    fractions: str | None,
    folds: int | None,
    by: str,
    seed: int,
    layers: tuple[str, ...],
    threshold: float,
) -> None:
    """Split the environments without separating duplicates, and print the splits as JSON.

    No environment has a duplicate in another split. With --by family, all environments of a family are in the same
    split.
    """
    from envcraft.corpus.splits import corpus_splits, families, family_splits
    from envcraft.corpus.store.environments import count

    chosen = _chosen(layers)
    with open_store(corpus) as store:
        number = count(store)
        # Before the search for duplicates, which takes longer and needs an extra.
        _refuse_empty(folds, (folds or 0) - number, number)
        if by == "family":
            shares = None if fractions is None and folds is None else _shares(fractions, folds)
            found = family_splits(store, shares, seed, chosen, threshold)
            family_of = {name: family for family, names in families(store).items() for name in names}
        else:
            shares = _shares(fractions, folds)
            found = corpus_splits(store, shares, seed, chosen, threshold)
    _refuse_empty(folds, found.count([]), number)
    splits: list[dict[str, Any]] = []
    for share, names in zip(shares or [1 / len(found)] * len(found), found, strict=True):
        splits.append({"fraction": share, "environments": names})
        if by == "family":
            splits[-1]["families"] = sorted({family_of[name] for name in names})
    _write({"seed": seed, "by": by, "layers": chosen, "threshold": threshold, "splits": splits})


def _chosen(layers: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in _NAMES if not layers or name in layers)


def _refuse_empty(folds: int | None, empty: int, environments: int) -> None:
    """Raise UsageError if some of the splits that ``--folds`` wants are empty."""
    if folds is not None and empty > 0:
        every = plural(environments, "environment")
        words = f"--folds {folds} leaves {plural(empty, 'split')} of {every} empty; name fewer"
        raise UsageError(words, setting="folds")


def _shares(fractions: str | None, folds: int | None) -> list[float]:
    if (fractions is None) == (folds is None):
        raise UsageError("give either --fractions, such as 0.8,0.1,0.1, or --folds, such as 5")
    if folds is not None:
        return [1 / folds] * folds
    try:
        return [float(part) for part in str(fractions).split(",")]
    except ValueError:
        raise UsageError(f"--fractions {fractions} are not numbers; write them like 0.8,0.1,0.1") from None


def _cluster_fields(cluster: Cluster) -> dict[str, Any]:
    return {"best": cluster.members[0], "others": cluster.members[1:], "layers": cluster.layers}


def _write(fields: dict[str, Any]) -> None:
    whole = {"schema": SCHEMA, "envcraft": __version__, **fields}
    click.echo(msgspec.json.format(msgspec.json.encode(plain(whole)), indent=2))


def _write_clusters(found: Duplicates, removed: bool) -> None:
    for name, layer in found.layers.items():
        extra = sum(len(members) - 1 for members in layer.clusters)
        lacking = found.environments - layer.keyed
        words = f"{plural(len(layer.clusters), 'cluster')}, {plural(extra, 'duplicate')}"
        click.echo(f"{name:11}  {words}" + (f"; {plural(lacking, 'environment')} without a key" if lacking else ""))
    extra = sum(len(cluster.members) - 1 for cluster in found.clusters)
    done = " removed" if removed else ""
    click.echo(
        f"{plural(found.environments, 'environment')}: {plural(len(found.clusters), 'cluster')}, "
        f"{plural(extra, 'duplicate')}{done}"
    )
    # Removed environments are all listed.
    shown = found.clusters if removed else found.clusters[:_SHOWN]
    for cluster in shown:
        names = cluster.members[1:] if removed else cluster.members[1 : _SHOWN + 1]
        click.echo(f"  {one_line(cluster.members[0])}  ({', '.join(cluster.layers)})")
        for name in names:
            click.echo(f"    {'removed ' if removed else ''}{one_line(name)}")
        if len(names) < len(cluster.members) - 1:
            click.echo(f"    and {len(cluster.members) - 1 - len(names):,} more")
    if len(shown) < len(found.clusters):
        click.echo(f"  and {plural(len(found.clusters) - len(shown), 'more cluster')}; --format json lists all")
