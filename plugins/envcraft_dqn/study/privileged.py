"""Privileged players in a study: they record demonstrations, and their scores are the ceiling."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from envcraft.corpus.audit import stored_targets
from envcraft.corpus.store import Environment, Store, environments
from envcraft.corpus.store.demonstrations import EpisodeOutcome
from envcraft.demonstrations import recorder
from envcraft.demonstrations.player import Player
from envcraft.environments.sources import resolve
from envcraft.errors import EnvCraftError, UsageError
from envcraft.judging.driver import Driver, ensure
from envcraft.judging.selection import driver_named
from envcraft.judging.statistics import Mean
from envcraft.registry import offered
from envcraft_dqn.privileged import failure
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.selection import StudyEnv

#: The player for environments without a specialised player.
_GENERIC = "search"


def player_for(environments: Sequence[StudyEnv]) -> Player:
    """The player for the families of all environments, or else the generic player. Raises UsageError without either."""
    families = {one.family for one in environments}
    players: list[Player] = list(offered("envcraft_players"))
    known = [player for player in players if player.families and all(player.plays(family) for family in families)]
    known += [player for player in players if player.name == _GENERIC]
    if not known:
        raise UsageError("no plugin has a player for demonstrations; `envcraft plugins` lists installed plugins")
    return known[0]


def record(
    corpus: Path, names: Sequence[str], player: Player, steps: int, seed: int, sandbox: str, workers: int | None
) -> int:
    """Record the missing demonstrations of a player, and return the number of new recordings.

    Args:
        corpus: The corpus with the environments and the recordings.
        names: The environments.
        player: The player.
        steps: The steps in each environment.
        seed: The seed of the episodes.
        sandbox: The sandbox driver.
        workers: The number of environments to play in parallel.

    Raises:
        EnvCraftError: The player fails.
    """
    contract = resolve(corpus, names[0]).contract
    with _driver(sandbox) as driver, Store(corpus, write=True) as store:
        ensure(driver)
        chosen = [_environment(store, name) for name in names]
        outcome = recorder.record(store, chosen, player, contract, driver, steps, seed, workers)
    for report in outcome.failed:
        raise EnvCraftError(f"the player {player.name} cannot play {report.path}: {failure(report)}")
    return outcome.done


def scores(corpus: Path, names: Sequence[str], player: Player, episodes: int, seed: int, sandbox: str) -> list[Score]:
    """The scores of a player in whole episodes, at least two. Raises EnvCraftError if the player fails."""
    contract = resolve(corpus, names[0]).contract
    found: dict[int, Score] = {}
    with _driver(sandbox) as driver, Store(corpus) as store:
        targets = stored_targets(store, [_environment(store, name) for name in names])
        # Tasks run in parallel, so that one worker suffices.
        for number, outcomes, report in recorder.episodes(targets, player, contract, driver, episodes, seed, workers=1):
            if not outcomes:
                raise EnvCraftError(f"the player {player.name} cannot play {report.path}: {failure(report)}")
            found[number] = _score(names[number], outcomes)
    return [found[number] for number in range(len(names))]


def _score(name: str, outcomes: Sequence[EpisodeOutcome]) -> Score:
    lengths, totals = [one.steps for one in outcomes], [one.total for one in outcomes]
    known = [float(one.success) for one in outcomes if one.success is not None]
    # One value has an infinite standard error, which JSON cannot store.
    wins = Mean.of(known) if len(known) > 1 else None
    return Score(name, len(outcomes), Mean.of(lengths), Mean.of(totals), wins)


@contextlib.contextmanager
def _driver(sandbox: str) -> Iterator[Driver]:
    with contextlib.closing(driver_named(sandbox, probe=False)) as driver:
        yield driver


def _environment(store: Store, name: str) -> Environment:
    row = environments.get(store, name)
    assert row is not None
    return row.environment
