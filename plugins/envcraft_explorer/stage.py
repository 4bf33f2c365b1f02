"""Opens environments of a corpus to be played: a bounded number at a time, each in workers of its own."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

from envcraft.contracts.lookup import contract_named
from envcraft.corpus.store import Environment, Store, decode, environments, generation, verdicts
from envcraft.demonstrations.player import Player, PolicyPlayer
from envcraft.errors import EnvCraftError, UsageError
from envcraft.judging.budget import BUDGETS
from envcraft.judging.check import Check
from envcraft.judging.driver import Driver, driver_for
from envcraft.judging.engine import Plan, open_subject
from envcraft.judging.selection import all_checks
from envcraft.judging.subject import Subject
from envcraft.model.project import with_project
from envcraft.model.target import PolicyFile, Target
from envcraft.model.verdict import CheckReport, Finding
from envcraft.registry import offered
from envcraft.text import one_line

#: How many environments are open at a time, and the longest time of one in seconds.
MOST, SECONDS = 20, 3_600.0
#: Steps per second of an environment that names no rate, and the bounds of one that does.
_RATE, _SLOWEST, _FASTEST = 15.0, 1.0, 60.0


class Full(EnvCraftError):
    """As many environments are open as the server allows."""


class Stage:
    """The environments of a corpus, to be played in the sandbox. Its methods may run in several threads.

    Args:
        root: the folder of the corpus.
        files: the folder that the corpus follows; empty if it follows none.
        driver: the sandbox.
        default: the name of the contract of environments without a verdict.
        most: how many environments are open at a time.
        chosen: players besides those of plugins and the policies of an environment, such as trained policies.
    """

    def __init__(
        self,
        root: Path,
        files: str,
        driver: Driver,
        default: str,
        most: int = MOST,
        chosen: Sequence[Player] = (),
    ) -> None:
        self._root, self._files, self._driver, self._default = root, files, driver, default
        self._most, self._open, self._lock = most, 0, threading.Lock()
        self._chosen = chosen
        self._checks: dict[str, Check] = {check.name: check for check in all_checks()}

    def names(self) -> list[str]:
        """The names of all environments, by number."""
        with Store(self._root) as store:
            return environments.names(store)

    def place(self) -> contextlib.AbstractContextManager[None]:
        """One of the places for open environments.

        Raises:
            Full: there is none left.
        """
        with self._lock:
            if self._open >= self._most:
                raise Full(f"{self._most} environments are being played, which is the limit; close one first")
            self._open += 1
        return self._held()

    @contextlib.contextmanager
    def _held(self) -> Iterator[None]:
        try:
            yield
        finally:
            with self._lock:
                self._open -= 1

    def subject(self, name: str, policy: PolicyFile | None = None) -> Subject:
        """Open an environment. Close it in the end.

        Args:
            name: in the corpus.
            policy: a privileged policy for it.

        Raises:
            UsageError: there is no such environment or contract.
            CorpusDamaged: its source cannot be read.
        """
        plan, target = self.plan(name, policy)
        return open_subject(plan, target)

    def plan(self, name: str, policy: PolicyFile | None = None) -> tuple[Plan, Target]:
        """How an environment is played, and its target. Raises as :meth:`subject` does."""
        with Store(self._root) as store:
            environment = _environment(store, name)
            source = store.source(environment.source)
            given = next(verdicts.given(store, environment.source, environment.env_class), None)
            path = f"{self._files}/{name}" if self._files else str(store.place(environment.source))
        settings = None if given is None else given.settings
        env_class = environment.env_class or (decode(given.report).env_class if given is not None else None)
        target = Target(path, source, env_class)
        if self._files:
            target = with_project(target)
        contract = contract_named(self._default if settings is None else settings.contract)
        budget = BUDGETS.get(settings.budget if settings is not None else "", BUDGETS["standard"])
        plan = Plan(
            [target],
            contract,
            driver_for(self._driver, [target]),
            list(self._checks.values()),
            budget,
            seed=0 if settings is None else settings.seed,
            policy=policy,
            parallel_jobs=1,
            time_limit=SECONDS,
        )
        return plan, target

    def findings(self, name: str) -> list[tuple[Check | None, Finding]]:
        """The findings of the last verdict on an environment, each with its check; None if that is not installed.

        Raises:
            UsageError: there is no such environment.
        """
        with Store(self._root) as store:
            environment = _environment(store, name)
            given = next(verdicts.given(store, environment.source, environment.env_class), None)
        checks: Sequence[CheckReport] = [] if given is None else decode(given.report).checks
        return [(self._checks.get(check.check), finding) for check in checks for finding in check.findings]

    def players(self, name: str) -> dict[str, Player]:
        """Who can play an environment, by name: players of plugins, the policies that were written for it, and those
        that the user chose.

        Raises:
            UsageError: there is no such environment.
        """
        with Store(self._root) as store:
            row = environments.get(store, name)
            if row is None:
                raise UsageError(f"the corpus has no environment {one_line(name)}")
            concept = row.origin.get("concept")
            written = generation.policies(store, concept) if isinstance(concept, str) else []
        family = row.origin.get("family")
        known: list[Player] = [
            player
            for player in offered("envcraft_players")
            if player.plays(family if isinstance(family, str) else None)
        ]
        for policy in written:
            label = f"policy {policy.number}"
            summary = f"reads the game state; won {policy.wins} of {policy.episodes} episodes"
            known.append(PolicyPlayer(PolicyFile(f"{label}.py", policy.source), label, summary))
        return {player.name: player for player in (*known, *self._chosen)}


def rate_of(subject: Subject) -> float:
    """The frames per second that an environment names, in reasonable bounds."""
    rendering = subject.load().description.get("rendering")
    rate = rendering["fps"] if rendering is not None else None
    return _RATE if rate is None else min(max(rate, _SLOWEST), _FASTEST)


def _environment(store: Store, name: str) -> Environment:
    row = environments.get(store, name)
    if row is None:
        raise UsageError(f"the corpus has no environment {one_line(name)}")
    return row.environment
