"""The environments of a study: those of a corpus, or newly generated ones."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import click
import msgspec

from envcraft.corpus.deduplication import clusters
from envcraft.corpus.store import Environment, Store, is_corpus
from envcraft.corpus.store import environments as store_environments
from envcraft.environments.families import axes_from, families_named, family_named
from envcraft.environments.sources import resolve
from envcraft.errors import UsageError

#: The family to generate without a corpus. Its episodes last longer under better play.
FAMILY = "tetris"
#: Layers of :mod:`envcraft.corpus.deduplication` under which two environments count as equal.
_SAME = ("exact", "structural")


class EnvFactory(msgspec.Struct, frozen=True):
    """Makes environments of a corpus, by the simulator of their family (`fast`) or by their files.

    With `trust` files run without a verdict: those that the study itself generated.
    """

    corpus: str
    fast: bool
    trust: bool = False

    def open(self, names: Sequence[str]) -> Any:
        """A vector of named environments, in this process."""
        from envcraft.environments.vector import make_vec

        # Tasks run in parallel, so that each needs no further processes.
        return make_vec(list(names), corpus=self.corpus, fast=self.fast, trust=self.trust, workers=0)


class StudyEnv(msgspec.Struct, frozen=True):
    """An environment of a study.

    Attributes:
        name: Its name.
        source: The SHA-256 of its source.
        family: Its family, or empty.
        kind: The kind within its family, or empty.
    """

    name: str
    source: str
    family: str
    kind: str = ""


def generate(root: Path, count: int, seed: int, families: Sequence[str] = (FAMILY,), where: Sequence[str] = ()) -> Path:
    """Add the first `count` variants of each family to the corpus `root`, which is created if needed.

    Raises:
        UsageError: A family has no such axis or value as `where` has, each as ``AXIS=VALUE``.
    """
    known = families_named(",".join(families), axes=axes_from(where))
    with Store(root, write=True) if is_corpus(root) else Store.create(root) as store, store.transaction():
        for family in known:
            click.echo(f"generating {count:,} environments of the family {family.name}", err=True)
            for one in family.generate(count, seed):
                origin = {"family": family.name, "seed": seed, **one.metadata}
                store.add(f"{one.name}.py", one.source.encode(), origin=origin)
    return root


def select(corpus: Path, patterns: Sequence[str]) -> list[StudyEnv]:
    """Select distinct environments of a corpus.

    Of several environments that differ only in layout or local names, it takes the first and reports the number of
    skipped copies on stderr.

    Args:
        corpus: The corpus.
        patterns: Shell patterns of names; without patterns, all names match.

    Raises:
        UsageError: No environment matches.
    """
    with Store(corpus, write=True) as store:
        rows = [
            row
            for row in store_environments.rows(store)
            if not patterns or any(fnmatchcase(row.environment.name, pattern) for pattern in patterns)
        ]
        # A test environment whose copy is in the training set would not be a test.
        duplicates = clusters(store, _SAME, members=[row.environment for row in rows]).clusters
    copies = {name for cluster in duplicates for name in cluster.members[1:]}
    if copies:
        click.echo(
            f"skipped {len(copies):,} of {len(rows):,} environments, because they are copies of others", err=True
        )
    envs = [_study_env(*row) for row in rows if row.environment.name not in copies]
    if not envs:
        such = f" that matches {' or '.join(patterns)}" if patterns else ""
        raise UsageError(f"{corpus} has no environment{such}; `envcraft corpus list {corpus}` lists them")
    return envs


def _study_env(environment: Environment, origin: dict[str, Any]) -> StudyEnv:
    family = origin.get("family", "")
    kind = family_named(family).kind(origin) if family else ""
    return StudyEnv(environment.name, environment.source, family, kind)


def factory_for(corpus: Path, environments: Sequence[StudyEnv], generated: bool = False) -> EnvFactory:
    """A factory with the simulator of the family if it supports all environments, and with their files otherwise.

    Files that the study itself `generated` from installed families run without a verdict.

    Raises:
        UsageError: The files must run, and one of them has not passed.
    """
    fast = EnvFactory(str(corpus), True)
    names = [one.name for one in environments]
    try:
        fast.open(names).close()
        return fast
    except UsageError:
        if generated:
            return EnvFactory(str(corpus), False, True)
        for name in names:
            resolve(corpus, name).ensure_trusted()
        return EnvFactory(str(corpus), False)
