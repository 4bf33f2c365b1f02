"""Players of the hook ``envcraft_players``: they see more than the frame, and play in the sandbox."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from envcraft.cli import offered
from envcraft.errors import EnvCraftError, UsageError

if TYPE_CHECKING:
    from envcraft.demonstrations.player import Player
    from envcraft.demonstrations.recording import Tell
    from envcraft.sandbox import Driver
    from envcraft.using.sources import Found
    from envcraft.verdict import SubjectReport
    from envcraft_dqn.evaluation import Evaluation

#: Those that play by the frame alone, in batches (:func:`envcraft_dqn.evaluation.player_named`).
OWN = ("random", "noop")


def players() -> dict[str, Player]:
    """The players of the plugins, by name, but for those that this package has itself."""
    return {player.name: player for player in offered("envcraft_players") if player.name not in OWN}


def evaluate(
    player: Player,
    target: Path,
    names: Sequence[str],
    contract: str | None,
    episodes: int,
    seed: int,
    sandbox: str | None,
    workers: int | None,
) -> list[Evaluation]:
    """Have a player play so many episodes, at least two, in each of these environments of a corpus, or in a file.

    A word on stderr tells which are left out, for what reason. Raises UsageError where none is left, and what the
    sandbox raises.
    """
    from envcraft.demonstrations.recording import episodes as play
    from envcraft.stats import Mean
    from envcraft.target import Target
    from envcraft_dqn.evaluation import Evaluation

    done: dict[str, Evaluation] = {}
    for found in _by_contract(_playable(player, target, names, contract)):
        targets = [Target(one.name, one.source, one.env_class) for one in found]
        with _driver(sandbox) as driver, _shown() as tell:
            for number, outcomes, report in play(
                targets, player, found[0].contract, driver, episodes, seed, workers, tell
            ):
                name = found[number].name
                if not outcomes:
                    _tell_wrong(report)
                    continue
                lengths, returns = [one.steps for one in outcomes], [one.total for one in outcomes]
                done[name] = Evaluation(name, episodes, Mean.of(lengths), Mean.of(returns), lengths, returns)
    if not done:
        raise EnvCraftError(f"{player.name} could play none of the environments")
    return [done[name] for name in names if name in done]


def record(
    player: Player,
    target: Path,
    names: Sequence[str],
    contract: str | None,
    folder: Path,
    steps: int,
    seed: int,
    sandbox: str | None,
    workers: int | None,
) -> None:
    """Have a player play so many steps in each of these environments, and keep what it does in a corpus in `folder`;
    what is there already stays. As :func:`evaluate` otherwise.
    """
    from envcraft.corpus.store import Environment, Store, is_corpus
    from envcraft.demonstrations import recording

    chosen = _playable(player, target, names, contract)
    with Store(folder, write=True) if is_corpus(folder) else Store.create(folder) as store:
        for one in chosen:
            store.add(one.name, one.source, one.env_class or "", one.origin)
        for found in _by_contract(chosen):
            environments = [Environment(one.name, one.sha256, one.env_class or "") for one in found]
            with _driver(sandbox) as driver, _shown() as tell:
                outcome = recording.record(
                    store, environments, player, found[0].contract, driver, steps, seed, workers, tell
                )
            for report in outcome.bad:
                _tell_wrong(report)


def _playable(player: Player, target: Path, names: Sequence[str], contract: str | None) -> list[Found]:
    """The environments that the player knows how to play."""
    from envcraft.using.sources import locate

    every = [locate(target, None if target.is_file() else name, contract) for name in names]
    found = [one for one in every if player.plays(one.origin.get("family"))]
    if not found:
        raise UsageError(
            f"{player.name} plays only the family {' and '.join(player.families)}, and there is none of it"
        )
    if left := len(every) - len(found):
        click.echo(
            f"{left:,} of {len(every):,} environments left out, whose family {player.name} does not play", err=True
        )
    return found


def _by_contract(found: Iterable[Found]) -> list[list[Found]]:
    """Those that have the same contract together: one run has one."""
    groups: dict[str, list[Found]] = {}
    for one in found:
        groups.setdefault(one.contract.name, []).append(one)
    return list(groups.values())


def _tell_wrong(report: SubjectReport) -> None:
    from envcraft.reports import one_line

    found = [f"{finding.code} {finding.message}" for check in report.checks for finding in check.findings]
    reasons = [check.reason for check in report.checks if check.reason]
    words = "; ".join(found or reasons) or report.reason or "it could not be played"
    click.echo(f"{one_line(report.path)} is left out: {one_line(words)}", err=True)


@contextlib.contextmanager
def _driver(sandbox: str | None) -> Iterator[Driver]:
    from envcraft.commands.choices import driver_named

    with contextlib.closing(driver_named(sandbox or "auto")) as driver:
        yield driver


@contextlib.contextmanager
def _shown() -> Iterator[Tell]:
    """Progress on standard error."""
    from envcraft.progress import Progress

    with Progress(io.StringIO()) as progress:
        yield progress.handle
