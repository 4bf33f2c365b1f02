"""What privileged players do: their demonstrations, which an agent begins with, and how far they get themselves."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path

from envcraft.cli import offered
from envcraft.commands.choices import driver_named
from envcraft.corpus.audit import stored
from envcraft.corpus.store import Environment, Store
from envcraft.demonstrations import recording
from envcraft.demonstrations.player import Player
from envcraft.errors import EnvCraftError, UsageError
from envcraft.sandbox import ensure
from envcraft.stats import Mean
from envcraft.using.sources import locate
from envcraft.verdict import SubjectReport
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.places import Chosen

#: Who plays what no other player is made for.
_ANY = "search"


def player_for(environments: Sequence[Chosen]) -> Player:
    """The player that is made for the family of all these environments, else the one that plays any.

    Raises UsageError where there is none.
    """
    families = {one.family for one in environments}
    players: list[Player] = list(offered("envcraft_players"))
    known = [player for player in players if player.families and all(player.plays(family) for family in families)]
    known += [player for player in players if player.name == _ANY]
    if not known:
        raise UsageError("no plugin gives a player for demonstrations; `envcraft plugins` lists what is installed")
    return known[0]


def record(
    corpus: Path, names: Sequence[str], player: Player, steps: int, seed: int, sandbox: str, workers: int | None
) -> int:
    """Have the player record so many steps of each environment, where it has not yet; give how many were missing.

    Raises EnvCraftError where an environment cannot be played.
    """
    contract = locate(corpus, names[0]).contract
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, probe=False)
        stack.callback(driver.close)
        ensure(driver)
        store = stack.enter_context(Store(corpus, write=True))
        found = recording.record(
            store, [_environment(store, name) for name in names], player, contract, driver, steps, seed, workers
        )
    for report in found.bad:
        raise EnvCraftError(f"the player {player.name} gives no demonstrations of {report.path}: {_words(report)}")
    return found.done


def scores(corpus: Path, names: Sequence[str], player: Player, episodes: int, seed: int, sandbox: str) -> list[Score]:
    """What the player comes to in whole episodes, two at least. Raises EnvCraftError where it cannot play."""
    contract = locate(corpus, names[0]).contract
    found: dict[int, Score] = {}
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, probe=False)
        stack.callback(driver.close)
        store = stack.enter_context(Store(corpus))
        targets = stored(store, [_environment(store, name) for name in names])
        # Tasks are what runs side by side.
        for number, outcomes, report in recording.episodes(
            targets, player, contract, driver, episodes, seed, workers=1
        ):
            if not outcomes:
                raise EnvCraftError(f"the player {player.name} cannot play {report.path}: {_words(report)}")
            lengths, totals = [one.steps for one in outcomes], [one.total for one in outcomes]
            found[number] = Score(names[number], episodes, Mean.of(lengths), Mean.of(totals))
    return [found[number] for number in range(len(names))]


def _words(report: SubjectReport) -> str:
    """What went wrong."""
    findings = [finding.message for check in report.checks for finding in check.findings]
    return "; ".join([*findings, *(check.reason for check in report.checks if check.reason)]) or report.reason


def _environment(store: Store, name: str) -> Environment:
    row = store.db.execute("SELECT name, source, class FROM environments WHERE name = ?", (name,)).fetchone()
    return Environment(*row)
