"""The environments of a study: those of a corpus, or a new one of the family that a study is made for."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import click
import msgspec

from envcraft.commands.choices import family_named
from envcraft.corpus.likeness import Member, clusters
from envcraft.corpus.store import Store, is_corpus
from envcraft.errors import UsageError
from envcraft.using.sources import locate

#: The family whose variants are written where no corpus is named, and whose episodes last as long as they are played
#: well.
FAMILY = "tetris"
#: Layers of :mod:`envcraft.corpus.likeness` that say that two environments are one.
_SAME = ("exact", "structural")


class Place(msgspec.Struct, frozen=True):
    """A corpus, and whether its environments are played by the program of their family (`fast`)."""

    corpus: str
    fast: bool

    def open(self, names: Sequence[str]) -> Any:
        """A vector of these environments, in this process."""
        from envcraft.using.vector import make_vec

        # Tasks are what runs side by side.
        return make_vec(list(names), corpus=self.corpus, fast=self.fast, workers=0)


class Chosen(msgspec.Struct, frozen=True):
    """An environment of a study: its name, the SHA-256 of its source, its family, and which kind of that family's it
    is; "" for none.
    """

    name: str
    source: str
    family: str
    kind: str = ""


def written(root: Path, count: int, seed: int) -> Path:
    """The corpus `root` with so many variants of the family, which are written where they are missing."""
    with Store(root, write=True) if is_corpus(root) else Store.create(root) as store, store.transaction():
        for one in family_named(FAMILY).generate(count, seed):
            origin = {"family": FAMILY, "seed": seed, **one.metadata}
            store.add(f"{one.name}.py", one.source.encode(), origin=origin)
    return root


def chosen(corpus: Path, patterns: Sequence[str]) -> list[Chosen]:
    """The environments whose names fit one of the patterns, or all; of several of these that are the same one, but for
    layout or the names of their own, the first. A word on stderr tells how many are left out.

    Raises UsageError where there is none.
    """
    with Store(corpus, write=True) as store:
        rows = [
            row
            for row in store.db.execute("SELECT name, source, class, origin FROM environments ORDER BY name").fetchall()
            if not patterns or any(fnmatchcase(row[0], pattern) for pattern in patterns)
        ]
        # One that is tested and its copy that is trained on would be no test.
        alike = clusters(store, _SAME, members=[Member(*row[:3]) for row in rows]).clusters
    copies = {name for cluster in alike for name in cluster.members[1:]}
    if copies:
        click.echo(f"{len(copies):,} of {len(rows):,} environments are copies of others and left out", err=True)
    found = [_chosen(name, source, json.loads(origin)) for name, source, _, origin in rows if name not in copies]
    if not found:
        words = f"no environment that {' or '.join(patterns)} fits" if patterns else "no environment"
        raise UsageError(f"{corpus} has {words}; `envcraft corpus list {corpus}` lists them")
    return found


def _chosen(name: str, source: str, origin: dict[str, Any]) -> Chosen:
    if not (family := origin.get("family", "")):
        return Chosen(name, source, "")
    return Chosen(name, source, family, family_named(family).kind(origin))


def place_of(corpus: Path, environments: Sequence[Chosen]) -> Place:
    """How these environments are played: by their family where it can, or by their own code, which must have passed.

    Raises UsageError, naming the next step.
    """
    fast = Place(str(corpus), True)
    names = [one.name for one in environments]
    try:
        fast.open(names).close()
        return fast
    except UsageError:
        for name in names:
            locate(corpus, name).ensure_trusted()
        return Place(str(corpus), False)
