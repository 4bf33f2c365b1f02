"""Labels of attempts: whether an attempt passed everything, and why not.

An attempt passed if it is an environment of the corpus that counts as passed (:mod:`envcraft.corpus.trust`). An attempt
whose judging is not complete has no label.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any, NamedTuple

from envcraft.corpus.export.exporter import Order
from envcraft.corpus.store import generation
from envcraft.generation.stages import Attempt, ConceptState
from envcraft.model.verdict import Verdict
from envcraft_llm.findings import summary_line, to_repair
from envcraft_llm.stages.repair import parent_of

#: The settings of a verdict that a row has.
_SETTINGS = ("rules", "contract", "contract_sha256", "budget", "seed", "driver", "image")


class PublishedAttempt(NamedTuple):
    """An environment of the corpus that comes from an attempt; `settings` are those of its last verdict."""

    name: str
    origin: dict[str, Any]
    verdict: str | None
    passed: bool
    settings: dict[str, Any]


class LabelledAttempt(NamedTuple):
    """An attempt with a label.

    Attributes:
        attempt: The attempt.
        parent: The attempt that it repairs.
        reason: Why it did not pass, or "".
        published: The environment that comes from it.
        settings: Settings of the verdict.
    """

    attempt: Attempt
    parent: Attempt | None
    reason: str
    published: PublishedAttempt | None
    settings: dict[str, Any]

    @property
    def passed(self) -> bool:
        return not self.reason


class Labels:
    """The labels of the attempts in a corpus.

    Raises:
        CorpusDamaged: If the corpus cannot be read.
    """

    def __init__(self, order: Order) -> None:
        self._store = order.store
        passing = {environment.name for environment in order.environments()}
        self._published: dict[tuple[str, str, str], PublishedAttempt] = {}
        for environment in dataclasses.replace(order, everything=True).environments():
            # Environments that were not generated have no concept. Of copies, the first by name counts.
            key = (str(environment.origin.get("concept")), environment.source, environment.env_class)
            settings = {name: getattr(environment, name) for name in _SETTINGS}
            passed = environment.name in passing
            self._published.setdefault(
                key, PublishedAttempt(environment.name, environment.origin, environment.verdict, passed, settings)
            )

    def of(self, state: ConceptState) -> list[LabelledAttempt]:
        """Return the attempts at a concept that have a label, in order."""
        settings = {
            number: {name: getattr(found, name) for name in _SETTINGS}
            for number, found in generation.attempt_settings(self._store, state.concept).items()
        }
        labelled = []
        for attempt in state.attempts:
            published = self._published.get((state.concept, sha256(attempt.source), attempt.env_class))
            reason = _reason(state, attempt, published)
            if reason is not None:
                parent = parent_of(state, attempt.number)
                own = settings[attempt.number] if published is None else published.settings
                labelled.append(LabelledAttempt(attempt, parent, reason, published, own))
        return labelled


def sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _reason(state: ConceptState, attempt: Attempt, published: PublishedAttempt | None) -> str | None:
    """Why an attempt did not pass, "" if it passed, None if it has no label."""
    if attempt.report is None or attempt.report.verdict is Verdict.ERROR:
        return None
    if attempt.degenerate:
        return f"gutted: {attempt.degenerate}"
    if failed := to_repair(attempt.report):
        return summary_line(failed)
    if attempt is not state.best:
        return None
    rejected = next((outcome.reason for outcome in state.outcomes.values() if outcome.result == "rejected"), None)
    if rejected is not None or published is None:
        return rejected
    if published.passed:
        return ""
    return "judged again: it fails" if published.verdict == Verdict.FAIL else None
