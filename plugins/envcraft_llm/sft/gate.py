"""What became of each attempt: whether it passed everything, and if not, why.

An attempt has passed where it became an environment of the corpus that counts as passed
(:mod:`envcraft.corpus.trust`). Of one that nobody has judged to the end nothing is said.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any, NamedTuple

from envcraft.corpus.export import Order
from envcraft.corpus.store import Store
from envcraft.stages import Attempt, Case
from envcraft.verdict import Verdict
from envcraft_llm.findings import brief_words, to_repair
from envcraft_llm.stages.repair import standing_before

#: The settings of a verdict, by the names that the table has for them.
_SETTINGS = ("rules", "contract", "contract_sha256", "budget", "seed", "driver", "image")


class Published(NamedTuple):
    """An environment of the corpus that came of an attempt: `settings` are those of its last verdict."""

    name: str
    origin: dict[str, Any]
    verdict: str | None
    passed: bool
    settings: dict[str, Any]


class Judged(NamedTuple):
    """An attempt of which it is settled whether it passed.

    Attributes:
        parent: the attempt that it repairs.
        reason: why it did not pass, "" where it did.
        published: the environment that came of it.
        settings: those of the verdict.
    """

    attempt: Attempt
    parent: Attempt | None
    reason: str
    published: Published | None
    settings: dict[str, Any]

    @property
    def passed(self) -> bool:
        return not self.reason


class Gate:
    """The verdicts of a corpus, on attempts and on the environments that came of them."""

    def __init__(self, order: Order) -> None:
        """Raises CorpusDamaged."""
        self._store: Store = order.store
        passing = {environment.name for environment in order.environments()}
        self._published: dict[tuple[str, str, str], Published] = {}
        for environment in dataclasses.replace(order, everything=True).environments():
            # Only what was generated says so, and the first by name stands for copies.
            key = (str(environment.origin.get("concept")), environment.source, environment.env_class)
            settings = {name: getattr(environment, name) for name in _SETTINGS}
            passed = environment.name in passing
            self._published.setdefault(
                key, Published(environment.name, environment.origin, environment.verdict, passed, settings)
            )

    def judged(self, case: Case) -> list[Judged]:
        """The attempts at a concept that are settled, in order."""
        settings = self._settings(case)
        found = []
        for attempt in case.attempts:
            published = self._published.get((case.concept, sha256(attempt.source), attempt.env_class))
            reason = _reason(case, attempt, published)
            if reason is not None:
                parent = standing_before(case, attempt.number)
                own = settings[attempt.number] if published is None else published.settings
                found.append(Judged(attempt, parent, reason, published, own))
        return found

    def _settings(self, case: Case) -> dict[int, dict[str, Any]]:
        """By number of the attempt, those of the verdict on it."""
        rows = self._store.db.execute(
            "SELECT number, rules, contract, contract_sha256, budget, seed, driver, image FROM attempts "
            "JOIN verdicts ON verdicts.id = attempts.verdict JOIN settings ON settings.id = verdicts.settings "
            "WHERE concept = ?",
            (case.concept,),
        )
        return {number: dict(zip(_SETTINGS, row, strict=True)) for number, *row in rows}


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _reason(case: Case, attempt: Attempt, published: Published | None) -> str | None:
    """Why an attempt has not passed, "" where it has; None where that is not settled."""
    if attempt.report is None or attempt.report.verdict is Verdict.ERROR:
        return None
    if attempt.gutted:
        return f"gutted: {attempt.gutted}"
    if found := to_repair(attempt.report):
        return brief_words(found)
    if attempt is not case.best:
        return None
    rejected = next((outcome.reason for outcome in case.outcomes.values() if outcome.result == "rejected"), None)
    if rejected is not None or published is None:
        return rejected
    if published.passed:
        return ""
    return "judged again: it fails" if published.verdict == Verdict.FAIL else None
