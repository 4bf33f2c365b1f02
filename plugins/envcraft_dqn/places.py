"""Which environments a command is about, and how they are opened side by side."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from envcraft.errors import UsageError

if TYPE_CHECKING:
    from envcraft_dqn.spaces import OpenVector


def environments(
    target: Path, select: Sequence[str], contract: str | None, trust: bool, sandbox: str | None, workers: int | None
) -> tuple[list[str], OpenVector]:
    """The names of environments of a corpus that one of the patterns `select` fits, sorted, or the one in a file; and
    what opens them. Without `trust` or `sandbox` only those that have passed; a word on stderr tells how many more
    there are.

    Raises UsageError where there is none, CorpusDamaged.
    """
    if target.is_file():
        names, place = [str(target)], None
    else:
        names, place = _of_corpus(target, select, contract, trust or sandbox is not None), target

    def open_vector(wanted: Sequence[str]) -> Any:
        from envcraft.using.vector import make_vec

        # Starting processes takes longer than what a single environment is opened for.
        count = 0 if workers is None and len(wanted) == 1 else workers
        return make_vec(
            list(wanted),
            corpus=place,
            contract=contract,
            trust=trust,
            sandbox=sandbox,
            workers=count,
        )

    return names, open_vector


def _of_corpus(corpus: Path, select: Sequence[str], contract: str | None, untrusted: bool) -> list[str]:
    from envcraft.corpus.store import Store, find
    from envcraft.using.sources import locate

    with Store(find(corpus)) as store:
        names = [str(name) for (name,) in store.db.execute("SELECT name FROM environments ORDER BY name")]
    chosen = [name for name in names if not select or any(fnmatch.fnmatchcase(name, one) for one in select)]
    if not chosen:
        such = f" that {' or '.join(select)} fits" if select else ""
        raise UsageError(f"{corpus} has no environment{such}; `envcraft corpus list {corpus}` lists them")
    if untrusted:
        return chosen
    passed = [name for name in chosen if not locate(corpus, name, contract).doubt]
    if not passed:
        # Says what is wrong with it, and what to do.
        locate(corpus, chosen[0], contract).ensure_trusted()
    if left := len(chosen) - len(passed):
        click.echo(f"{left:,} of {len(chosen):,} environments have not passed and are left out", err=True)
    return passed
