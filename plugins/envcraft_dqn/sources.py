"""What ``--demos`` names: demonstrations that are played on the spot, or were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from envcraft_dqn import privileged
from envcraft_dqn.demonstrations import DemonstrationSource
from envcraft_dqn.evaluation import Played, player_named
from envcraft_dqn.places import contracts
from envcraft_dqn.recorded import Recorded
from envcraft_dqn.settings import Settings
from envcraft_dqn.spaces import OpenVector, Surface


@dataclass(frozen=True)
class Where:
    """Environments of `target`, a corpus or a file, as :func:`envcraft_dqn.places.environments` found them, and what it
    was told of where they run.
    """

    target: Path
    names: Sequence[str]
    open_vector: OpenVector
    contract: str | None = None
    sandbox: str | None = None
    workers: int | None = None


def source_named(name: str, where: Where, settings: Settings, folder: Path) -> DemonstrationSource:
    """``random``, ``noop`` and ``checkpoint:PATH`` play while they are read. ``CORPUS`` and ``CORPUS:PLAYER`` are what
    ``envcraft demos`` recorded there. A player of the hook ``envcraft_players`` plays in a sandbox before, unless it
    has in an earlier run, and what it did is kept in `folder`.

    Raises UsageError where there is no such thing, and what a sandbox raises.
    """
    if (seeing := privileged.players().get(name)) is not None:
        corpus = folder / "demonstrations"
        steps, seed, workers = settings.demonstrations, settings.seed, where.workers or None
        privileged.record(
            seeing, where.target, where.names, where.contract, corpus, steps, seed, where.sandbox, workers
        )
        return _recorded(corpus, name, where, steps, seeing.digest)
    path, colon, player = name.rpartition(":")
    if name not in privileged.OWN and Path(name).is_dir():
        return _recorded(Path(name), None, where, settings.demonstrations)
    if colon and path != "checkpoint" and Path(path).is_dir():
        return _recorded(Path(path), player, where, settings.demonstrations)
    surface = Surface.of(where.open_vector, where.names[0])
    chosen = player_named(name, surface, settings.seed, device=settings.device)
    return Played(where.open_vector, chosen, settings.demonstrations, settings.seed)


def _recorded(corpus: Path, player: str | None, where: Where, steps: int, player_digest: str | None = None) -> Recorded:
    """What was recorded in these environments, with a word on stderr where there are too few."""
    promised = contracts(where.target, where.names, where.contract)
    source = Recorded(corpus, where.open_vector, player, contracts=promised, player_digest=player_digest)
    if left := len(set(where.names) - set(source.names)):
        click.echo(f"{left:,} of {len(where.names):,} environments have no demonstration", err=True)
    if short := [name for name in source.names if source.steps(name) < steps]:
        click.echo(
            f"{len(short):,} of {len(where.names):,} environments have fewer than {steps:,} steps of demonstrations, "
            f"such as {short[0]} with {source.steps(short[0]):,}",
            err=True,
        )
    return source
