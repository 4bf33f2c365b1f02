"""Players of the hook ``envcraft_players``, which see the state of an environment and play in the sandbox."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np
from numpy.typing import NDArray

from envcraft.errors import EnvCraftError, UsageError
from envcraft.registry import offered
from envcraft_dqn.policies import NAMES

if TYPE_CHECKING:
    from envcraft.demonstrations.player import Player
    from envcraft.demonstrations.recorder import EventHandler
    from envcraft.environments.sources import EnvSource
    from envcraft.judging.driver import Driver
    from envcraft.model.verdict import SubjectReport
    from envcraft_dqn.evaluation import Evaluation
    from envcraft_dqn.selection import Selection


def players() -> dict[str, Player]:
    """The players of all plugins by name, except those whose names this package uses for policies."""
    return {player.name: player for player in offered("envcraft_players") if player.name not in NAMES}


def evaluate(player: Player, selection: Selection, episodes: int, seed: int) -> list[Evaluation]:
    """Play episodes in each selected environment.

    Skipped environments are reported on stderr with the reason.

    Args:
        player: The player.
        selection: The environments.
        episodes: The episodes of each environment, at least two.
        seed: The seed of the episodes.

    Raises:
        UsageError: The player supports none of the environments.
        EnvCraftError: The player fails in all environments, or the sandbox fails.
    """
    from envcraft.demonstrations.recorder import episodes as play
    from envcraft.judging.statistics import Mean
    from envcraft.model.target import Target
    from envcraft_dqn.evaluation import Evaluation

    done: dict[str, Evaluation] = {}
    for found in _by_contract(_playable(player, selection)):
        targets = [Target(one.name, one.source, one.env_class) for one in found]
        with _driver(selection.sandbox) as driver, _progress() as tell:
            for number, outcomes, report in play(
                targets, player, found[0].contract, driver, episodes, seed, selection.workers or None, tell
            ):
                name = found[number].name
                if not outcomes:
                    _report_failure(report)
                    continue
                lengths, returns = [one.steps for one in outcomes], [one.total for one in outcomes]
                done[name] = Evaluation(name, episodes, Mean.of(lengths), Mean.of(returns), lengths, returns)
    if not done:
        raise EnvCraftError(f"{player.name} could not play any of the environments")
    return [done[name] for name in selection.names if name in done]


def record(player: Player, selection: Selection, folder: Path, steps: int, seed: int) -> None:
    """Record steps of a player in each selected environment, into a corpus in `folder`.

    Existing recordings stay. Failures are handled as in :func:`evaluate`.
    """
    from envcraft.corpus.store import Environment, Store, is_corpus
    from envcraft.demonstrations import recorder

    chosen = _playable(player, selection)
    with Store(folder, write=True) if is_corpus(folder) else Store.create(folder) as store:
        for one in chosen:
            store.add(one.name, one.source, one.env_class or "", one.origin)
        for found in _by_contract(chosen):
            environments = [Environment(one.name, one.sha256, one.env_class or "") for one in found]
            with _driver(selection.sandbox) as driver, _progress() as tell:
                outcome = recorder.record(
                    store,
                    environments,
                    player,
                    found[0].contract,
                    driver,
                    steps,
                    seed,
                    selection.workers or None,
                    tell,
                )
            for report in outcome.failed:
                _report_failure(report)


class PlayerAdviser:
    """A player of the hook ``envcraft_players`` that labels episodes of a learner, in the sandbox.

    Args:
        player: The player.
        target: The corpus, or the file.
        contract: The name of the contract, or None for that of the verdicts.
        sandbox: The sandbox driver, or None for the strongest one.
        workers: The number of environments in parallel, or None for one per core.
    """

    def __init__(
        self, player: Player, target: Path, contract: str | None, sandbox: str | None, workers: int | None
    ) -> None:
        self._player, self._target, self._contract = player, target, contract
        self._sandbox, self._workers = sandbox, workers

    def advise(self, episodes: Sequence[tuple[str, int, NDArray[np.int64]]]) -> list[NDArray[np.int64] | None]:
        """See :meth:`envcraft_dqn.demonstrations.Adviser.advise`."""
        from envcraft.demonstrations import recorder
        from envcraft.environments.sources import resolve
        from envcraft.model.target import Target

        by_name: dict[str, list[int]] = {}
        for number, (name, _, _) in enumerate(episodes):
            by_name.setdefault(name, []).append(number)
        target = self._target
        sources = [resolve(target, None if target.is_file() else name, self._contract) for name in by_name]
        found: list[NDArray[np.int64] | None] = [None] * len(episodes)
        reason = ""
        with _driver(self._sandbox) as driver:
            for same in _by_contract(sources):
                numbers = [by_name[one.name] for one in same]
                played = [[(episodes[at][1], episodes[at][2].tolist()) for at in some] for some in numbers]
                targets = [Target(one.name, one.source, one.env_class) for one in same]
                for place, advice, report in recorder.advise(
                    targets, self._player, same[0].contract, driver, played, self._workers or None
                ):
                    reason = reason if advice else failure(report)
                    for at, actions in zip(numbers[place], advice, strict=False):
                        found[at] = np.array(actions, np.int64)
        if all(one is None for one in found):
            raise EnvCraftError(f"{self._player.name} advises on none of {len(episodes)} episodes: {reason}")
        return found


class FamilyAdviser:
    """Asks the adviser of each environment.

    Args:
        advisers: The advisers by the names of environments.
    """

    def __init__(self, advisers: Mapping[str, PlayerAdviser]) -> None:
        self._advisers = advisers

    def advise(self, episodes: Sequence[tuple[str, int, NDArray[np.int64]]]) -> list[NDArray[np.int64] | None]:
        """See :meth:`envcraft_dqn.demonstrations.Adviser.advise`."""
        found: list[NDArray[np.int64] | None] = [None] * len(episodes)
        for adviser in dict.fromkeys(self._advisers[name] for name, _, _ in episodes):
            places = [at for at, (name, _, _) in enumerate(episodes) if self._advisers[name] is adviser]
            for at, labels in zip(places, adviser.advise([episodes[at] for at in places]), strict=True):
                found[at] = labels
        return found


def failure(report: SubjectReport) -> str:
    """The findings of a report as text, or the reasons why a check could not judge."""
    findings = [f"{finding.code} {finding.message}" for check in report.checks for finding in check.findings]
    reasons = [check.reason for check in report.checks if check.reason]
    return "; ".join(findings or reasons) or report.reason or "the player failed"


def _playable(player: Player, selection: Selection) -> list[EnvSource]:
    """The environments that the player supports. Raises UsageError if there are none."""
    from envcraft.environments.sources import resolve

    target = selection.target
    every = [resolve(target, None if target.is_file() else name, selection.contract) for name in selection.names]
    found = [one for one in every if player.plays(one.origin.get("family"))]
    if not found:
        families = " and ".join(player.families)
        raise UsageError(f"{player.name} supports only the family {families}, and no environment belongs to it")
    if skipped := len(every) - len(found):
        click.echo(
            f"skipped {skipped:,} of {len(every):,} environments, because {player.name} does not support their "
            "families",
            err=True,
        )
    return found


def _by_contract(found: Iterable[EnvSource]) -> list[list[EnvSource]]:
    """Group environments by contract, since a run has a single contract."""
    groups: dict[str, list[EnvSource]] = {}
    for one in found:
        groups.setdefault(one.contract.name, []).append(one)
    return list(groups.values())


def _report_failure(report: SubjectReport) -> None:
    from envcraft.text import one_line

    click.echo(f"skipped {one_line(report.path)}: {one_line(failure(report))}", err=True)


@contextlib.contextmanager
def _driver(sandbox: str | None) -> Iterator[Driver]:
    from envcraft.judging.selection import driver_named

    with contextlib.closing(driver_named(sandbox or "auto")) as driver:
        yield driver


@contextlib.contextmanager
def _progress() -> Iterator[EventHandler]:
    """Show progress on stderr."""
    from envcraft.cli.progress import Progress

    with Progress(io.StringIO(), verb="played") as progress:
        yield progress.handle
