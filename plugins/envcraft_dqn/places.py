"""Which environments a command is about, and how they are opened side by side."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from envcraft.errors import UsageError

if TYPE_CHECKING:
    from envcraft.using.sources import Found
    from envcraft_dqn.spaces import OpenVector


def environments(
    target: Path,
    select: Sequence[str],
    contract: str | None,
    trust: bool,
    sandbox: str | None,
    workers: int | None,
    fast: bool | None = None,
) -> tuple[list[str], OpenVector]:
    """The names of environments of a corpus that one of the patterns `select` fits, sorted, or the one in a file; and
    what opens them. A word on stderr tells how many more there are that are left out.

    With `fast` the family that wrote them plays them itself, also what was never judged; with None it does so where it
    can play them all. Otherwise, without `trust` or `sandbox`, only what has passed is among them.

    Raises UsageError where there is none, or `fast` cannot be, CorpusDamaged.
    """
    if fast and sandbox is not None:
        raise UsageError("--fast runs none of the environments' code, so leave out --sandbox, or --fast")
    if target.is_file():
        if fast:
            raise UsageError(f"--fast plays what `envcraft generate` wrote into a corpus, and {target} is a file")
        names, place, fast = [str(target)], None, False
    else:
        names, place = _chosen(target, select), target
        simulated = None if fast is False or sandbox is not None else _simulated(target, names, contract, trust, fast)
        if simulated is None and not trust and sandbox is None:
            names = _passed(target, names, contract)
        names, fast = simulated or names, simulated is not None

    def open_vector(wanted: Sequence[str]) -> Any:
        from envcraft.using.vector import make_vec

        if fast:
            return make_vec(list(wanted), corpus=place, contract=contract, fast=True)
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


def sources(target: Path, names: Sequence[str], contract: str | None) -> dict[str, str]:
    """By name, what tells these environments from others: the digests of source and contract."""
    from envcraft.corpus.settings import contract_digest

    return {
        name: f"{one.sha256[:16]} under {one.contract.name} {contract_digest(one.contract)[:16]}"
        for name, one in zip(names, _located(target, names, contract), strict=True)
    }


def contracts(target: Path, names: Sequence[str], contract: str | None) -> dict[str, str]:
    """By name, the digests of what these environments promise."""
    from envcraft.corpus.settings import contract_digest

    found = _located(target, names, contract)
    return {name: contract_digest(one.contract) for name, one in zip(names, found, strict=True)}


def _chosen(corpus: Path, select: Sequence[str]) -> list[str]:
    """The names in a corpus that are asked for."""
    from envcraft.corpus.store import Store, find

    with Store(find(corpus)) as store:
        names = [str(name) for (name,) in store.db.execute("SELECT name FROM environments ORDER BY name")]
    chosen = [name for name in names if not select or any(fnmatch.fnmatchcase(name, one) for one in select)]
    if not chosen:
        such = f" that {' or '.join(select)} fits" if select else ""
        raise UsageError(f"{corpus} has no environment{such}; `envcraft corpus list {corpus}` lists them")
    return chosen


def _simulated(
    corpus: Path, names: list[str], contract: str | None, trust: bool, asked: bool | None
) -> list[str] | None:
    """Those that their family plays by a program of its own, unless `trust` without what was judged and has not passed;
    None where there is one that it cannot play. Raises UsageError in place of that where it was `asked` for.
    """
    from envcraft.using.fast import simulator

    found = _located(corpus, names, contract)
    if not asked and not all("family" in one.origin for one in found):
        return None
    kept = [one for one in found if trust or one.verdict is None or not one.doubt]
    if not kept:
        found[0].ensure_trusted()
    try:
        simulator(kept)
    except UsageError:
        if asked:
            raise
        return None
    _tell_left(len(found) - len(kept), len(found))
    click.echo(
        f"{len(kept):,} environments are played by the program of their family (--no-fast: by their files)", err=True
    )
    return [one.name for one in kept]


def _passed(corpus: Path, names: list[str], contract: str | None) -> list[str]:
    """Those that have passed. Raises UsageError where there is none."""
    found = _located(corpus, names, contract)
    passed = [one.name for one in found if not one.doubt]
    if not passed:
        # Says what is wrong with it, and what to do.
        found[0].ensure_trusted()
    _tell_left(len(found) - len(passed), len(found))
    return passed


def _located(target: Path, names: Sequence[str], contract: str | None) -> list[Found]:
    from envcraft.using.sources import locate

    return [locate(target, None if target.is_file() else name, contract) for name in names]


def _tell_left(left: int, count: int) -> None:
    if left:
        click.echo(f"{left:,} of {count:,} environments have not passed and are left out", err=True)
