"""What privileged players do: their demonstrations, which an agent begins with, and how far they get themselves."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from envcraft.budget import BUDGETS
from envcraft.check import Check, Skip
from envcraft.cli import offered
from envcraft.commands.choices import driver_named
from envcraft.corpus.audit import stored
from envcraft.corpus.store import Environment, Store
from envcraft.demonstrations import keeping, recording
from envcraft.demonstrations.form import rewards
from envcraft.demonstrations.player import Player
from envcraft.engine import Plan, stream
from envcraft.errors import EnvCraftError, UsageError
from envcraft.events import SubjectFinished
from envcraft.pool import Pool
from envcraft.sandbox import Limits, ensure
from envcraft.subject import Subject
from envcraft.using.sources import locate
from envcraft.verdict import Finding, Verdict
from envcraft_dqn.demonstrations import Episode
from envcraft_dqn.evaluation import Mean
from envcraft_dqn.study.metric import Score
from envcraft_dqn.study.places import Chosen, Place

#: Who plays what no other player is made for.
_ANY = "search"
#: Seconds that an environment's episodes may take together.
_SECONDS = 3600.0


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
        reasons = [finding.message for check in report.checks for finding in check.findings]
        reasons += [check.reason for check in report.checks if check.reason]
        raise EnvCraftError(
            f"the player {player.name} gives no demonstrations of {report.path}: {'; '.join(reasons) or report.reason}"
        )
    return found.done


class Recorded:
    """The recordings of one player, played again where the agent learns: seeds and actions are kept, not frames."""

    def __init__(self, place: Place, player: str, seed: int) -> None:
        self._place, self._player, self._seed = place, player, seed

    def episodes(self, name: str) -> Iterator[Episode]:
        """In the order in which they were recorded. Raises UsageError where something else comes out."""
        with Store(Path(self._place.corpus)) as store:
            rows = [row for one, row in keeping.rows(store, self._player) if one == name and row.seed == self._seed]
            if not rows:
                raise UsageError(f"{name} has no recording of the player {self._player}")
            found = keeping.read(store, rows[0])
        vector = self._place.open([name])
        try:
            for episode in found.episodes:
                seen, _ = vector.reset(seed=[episode.seed])
                frames, paid = [seen[0]], []
                actions = np.array(found.actions(episode))
                for action in actions:
                    seen, reward, _, _, _ = vector.step(action[None])
                    frames.append(seen[0])
                    paid.append(float(reward[0]))
                if not np.array_equal(paid, rewards(episode)):
                    raise UsageError(f"{name} gives other rewards than were recorded: `envcraft demos --verify` tells")
                yield Episode(np.stack(frames), actions, np.array(paid), episode.terminated)
        finally:
            vector.close()


class _Outcomes(Check):
    """Has a player play whole episodes, and takes how long they last and what they pay."""

    name = "outcomes"
    rules = ()

    def __init__(self, player: Player, episodes: int) -> None:
        self._player, self._episodes = player, episodes
        self.found: dict[str, list[tuple[int, float]]] = {}

    def judge(self, subject: Subject) -> Iterator[Finding]:
        played = []
        for number in range(self._episodes):
            trace = self._player.play(subject, number)
            if not trace.ended:
                raise Skip(f"episode {number} breaks off after {trace.steps} steps: {trace.fault or trace.ending}")
            played.append((trace.steps, trace.total))
        self.found[subject.target.path] = played
        yield from ()


def scores(corpus: Path, names: Sequence[str], player: Player, episodes: int, seed: int, sandbox: str) -> list[Score]:
    """What the player comes to in whole episodes, two at least. Raises EnvCraftError where it cannot play."""
    check = _Outcomes(player, episodes)
    limits = Limits(total=_SECONDS)
    contract = locate(corpus, names[0]).contract
    with contextlib.ExitStack() as stack:
        driver = driver_named(sandbox, probe=False)
        stack.callback(driver.close)
        store = stack.enter_context(Store(corpus))
        targets = stored(store, [_environment(store, name) for name in names])
        plan = Plan(targets, contract, driver, [check], BUDGETS["standard"], seed, player.policy, limits)
        pool = stack.enter_context(Pool(driver, limits, len(names)))
        # Tasks are what runs side by side.
        for _, event in stack.enter_context(contextlib.closing(stream(plan, 1, pool))):
            if isinstance(event, SubjectFinished) and event.report.verdict is not Verdict.PASS:
                reasons = "; ".join(one.reason for one in event.report.checks if one.reason) or event.report.reason
                raise EnvCraftError(f"the player {player.name} cannot play {event.report.path}: {reasons}")
    found = []
    for name in names:
        lengths, totals = zip(*check.found[name], strict=True)
        found.append(Score(name, episodes, Mean.of(lengths), Mean.of(totals)))
    return found


def _environment(store: Store, name: str) -> Environment:
    row = store.db.execute("SELECT name, source, class FROM environments WHERE name = ?", (name,)).fetchone()
    return Environment(*row)
