"""Select the environments of a command, and open them as vectors."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from envcraft.errors import UsageError
from envcraft.text import plural

if TYPE_CHECKING:
    from envcraft.environments.sources import EnvSource
    from envcraft_dqn.env_spec import OpenVector


@dataclass(frozen=True)
class Selection:
    """Selected environments.

    Attributes:
        target: The corpus, or the file.
        names: The sorted names of the environments.
        open_vector: Makes a vector of named environments.
        contract: The name of their contract, or None for the contract of their verdicts.
        sandbox: The sandbox driver, or None for this process.
        workers: The number of processes, or None for one per core.
    """

    target: Path
    names: list[str]
    open_vector: OpenVector
    contract: str | None = None
    sandbox: str | None = None
    workers: int | None = None


def select_environments(
    target: Path,
    patterns: Sequence[str] = (),
    contract: str | None = None,
    trust: bool = False,
    sandbox: str | None = None,
    workers: int | None = None,
    fast: bool | None = None,
) -> Selection:
    """Select environments of a corpus, or the environment in a file.

    Without `trust`, `sandbox` or `fast`, only environments that passed are selected. The number of skipped environments
    is reported on stderr.

    Args:
        target: The corpus or the file.
        patterns: Shell patterns of names; without patterns, all names match.
        contract: The name of a contract, or None for the contract of the verdict.
        trust: Whether to run environments in this process even if they have not passed.
        sandbox: The sandbox driver to run the environments in.
        workers: The number of processes; by default, one per core.
        fast: Whether the simulator of their family plays the environments, also those without a verdict. None uses the
            simulator if it supports all of them.

    Raises:
        UsageError: No environment matches, or the simulator does not support one.
        CorpusDamaged: The corpus cannot be read.
    """
    if fast and sandbox is not None:
        raise UsageError("--fast runs no code of the environments: omit --sandbox or --fast")
    corpus: Path | None = target
    if target.is_file():
        if fast:
            raise UsageError(f"--fast needs a corpus with environments of `envcraft generate`, and {target} is a file")
        names, corpus, fast = [str(target)], None, False
        if not trust and sandbox is None:
            _passed(target, names, contract)
    else:
        names = _matching(target, patterns)
        simulated = None if fast is False or sandbox is not None else _simulated(target, names, contract, trust, fast)
        if simulated is None and not trust and sandbox is None:
            names = _passed(target, names, contract)
        names, fast = simulated or names, simulated is not None

    def open_vector(wanted: Sequence[str]) -> Any:
        from envcraft.environments.vector import make_vec

        if fast:
            return make_vec(list(wanted), corpus=corpus, contract=contract, fast=True)
        # For a single environment, starting processes takes longer than stepping it here.
        count = 0 if workers is None and len(wanted) == 1 else workers
        return make_vec(
            list(wanted),
            corpus=corpus,
            contract=contract,
            trust=trust,
            sandbox=sandbox,
            workers=count,
        )

    return Selection(target, names, open_vector, contract, sandbox, workers)


def source_digests(target: Path, names: Sequence[str], contract: str | None) -> dict[str, str]:
    """The identities of environments by name: the digests of source and contract."""
    from envcraft.judging.settings import contract_digest

    return {
        name: f"{one.sha256[:16]} under {one.contract.name} {contract_digest(one.contract)[:16]}"
        for name, one in zip(names, _located(target, names, contract), strict=True)
    }


def contract_digests(target: Path, names: Sequence[str], contract: str | None) -> dict[str, str]:
    """The digests of the contracts of environments, by name."""
    from envcraft.judging.settings import contract_digest

    located = _located(target, names, contract)
    return {name: contract_digest(one.contract) for name, one in zip(names, located, strict=True)}


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Whether an environment's name, with or without its ``.py`` as in :func:`envcraft.make`, matches a pattern."""
    return any(fnmatch.fnmatchcase(form, one) for one in patterns for form in (name, name.removesuffix(".py")))


def _matching(corpus: Path, patterns: Sequence[str]) -> list[str]:
    """The names in a corpus that match one of the patterns."""
    from envcraft.corpus.store import Store, environments, find

    with Store(find(corpus)) as store:
        names = environments.names(store)
    matching = [name for name in names if not patterns or matches(name, patterns)]
    if not matching:
        such = f" that matches {' or '.join(patterns)}" if patterns else ""
        raise UsageError(f"{corpus} has no environment{such}; `envcraft corpus list {corpus}` lists them")
    return matching


def _simulated(
    corpus: Path, names: list[str], contract: str | None, trust: bool, required: bool | None
) -> list[str] | None:
    """The environments to simulate; None if the simulator does not support all of them.

    Without `trust`, environments that were judged and did not pass are skipped. Raises UsageError instead of returning
    None if the simulator is `required`.
    """
    from gymnasium.vector import AutoresetMode

    from envcraft.environments.families import simulate

    located = _located(corpus, names, contract)
    if not required and not all("family" in one.origin for one in located):
        return None
    kept = [one for one in located if trust or one.verdict is None or not one.doubt]
    if not kept:
        located[0].ensure_trusted()
    try:
        simulate(kept, AutoresetMode.NEXT_STEP, copy=False)
    except UsageError:
        if required:
            raise
        return None
    _report_skipped(len(located) - len(kept), len(located))
    played = plural(len(kept), "environment")
    click.echo(f"the simulator of the family plays {played} (--no-fast: their files run)", err=True)
    return [one.name for one in kept]


def _passed(corpus: Path, names: list[str], contract: str | None) -> list[str]:
    """The environments that passed. Raises UsageError if none did."""
    located = _located(corpus, names, contract)
    passed = [one.name for one in located if not one.doubt]
    if not passed:
        # Raises an error with the verdict and the next step.
        located[0].ensure_trusted()
    _report_skipped(len(located) - len(passed), len(located))
    return passed


def _located(target: Path, names: Sequence[str], contract: str | None) -> list[EnvSource]:
    from envcraft.environments.sources import resolve

    return [resolve(target, None if target.is_file() else name, contract) for name in names]


def _report_skipped(skipped: int, count: int) -> None:
    if skipped:
        click.echo(f"skipped {skipped:,} of {count:,} environments, because they have not passed", err=True)
