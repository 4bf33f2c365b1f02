"""The history of generation in a corpus: concepts, briefs, attempts, policies and stage outcomes.

Each row belongs to a concept and is written in one transaction, so an interrupted run leaves every row complete.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable
from typing import Any, cast

import msgspec

from envcraft.corpus.stages import in_running_order
from envcraft.corpus.store import Environment, Store, decode, generation
from envcraft.generation.stages import Attempt, ConceptState, PolicyAttempt, Result, StageOutcome
from envcraft.judging.settings import Settings
from envcraft.model.verdict import Severity, SubjectReport


class History:
    """The history of generation in an open corpus.

    Methods that write raise OSError, sqlite3.Error.

    Args:
        store: The corpus.
        settings: Settings of the verdicts to read and write; a verdict under other settings counts as absent. None
            reads every verdict and writes none.
    """

    def __init__(self, store: Store, settings: Settings | None = None) -> None:
        self.store = store
        self._settings = None if settings is None else store.settings(settings)

    # Reading

    def concepts(self) -> list[str]:
        """Return the ids of all concepts."""
        return generation.concepts(self.store)

    def state(self, concept: str) -> ConceptState | None:
        """Return everything stored about a concept; None if it does not exist.

        Raises:
            CorpusDamaged: If a source is missing or damaged.
        """
        row = generation.concept(self.store, concept)
        if row is None:
            return None
        brief = generation.brief(self.store, concept)
        return ConceptState(
            concept,
            row.title,
            row.text,
            row.data,
            brief[0] if brief else "",
            self._attempts(concept),
            [PolicyAttempt(*policy[1:]) for policy in generation.policies(self.store, concept)],
            self.outcomes(concept),
        )

    def outcomes(self, concept: str) -> dict[str, StageOutcome]:
        """Return the outcomes of a concept by stage."""
        rows = generation.outcomes(self.store, concept)
        return {row.stage: StageOutcome(cast(Result, row.result), row.reason, row.facts) for row in rows}

    def counts(self, concepts: Iterable[str]) -> dict[str, Counter[str]]:
        """Count results by stage.

        Args:
            concepts: Ids of the concepts to count.
        """
        ids = set(concepts)
        counts: dict[str, Counter[str]] = {}
        for concept, stage, result, _ in generation.outcome_results(self.store):
            if concept in ids:
                counts.setdefault(stage, Counter())[result] += 1
        return counts

    def reasons(self, concepts: Iterable[str]) -> dict[str, Counter[str]]:
        """Count the reasons of concepts that did not pass, up to the first colon, by stage.

        Args:
            concepts: Ids of the concepts to count.
        """
        ids = set(concepts)
        counts: dict[str, Counter[str]] = {}
        for concept, stage, result, reason in generation.outcome_results(self.store):
            if concept in ids and result != "passed":
                counts.setdefault(stage, Counter())[reason.partition(":")[0]] += 1
        return counts

    def yields(self, concepts: Iterable[str]) -> list[tuple[int, int]]:
        """Count attempts by number.

        Args:
            concepts: Ids of the concepts to count.

        Returns:
            For each attempt number, how many attempts were judged, and how many of them have no finding to repair and
            are not degenerate.
        """
        ids = set(concepts)
        judged: Counter[int] = Counter()
        sound: Counter[int] = Counter()
        for concept, number, result in generation.attempt_results(self.store):
            if concept in ids and result:
                judged[number] += 1
                sound[number] += result == "sound"
        return [(judged[number], sound[number]) for number in range(max(judged, default=-1) + 1)]

    def judged(self, attempt: Attempt, state: ConceptState) -> tuple[SubjectReport, dict[str, Any]] | None:
        """Return the stored report and profile of an attempt; None if its source has none under these settings."""
        found = generation.judged_attempt(
            self.store, state.concept, attempt.number, _sha256(attempt.source), attempt.env_class, self._settings
        )
        return None if found is None else (decode(found[0]), found[1])

    # Writing

    def keep_concepts(self, states: Iterable[ConceptState]) -> None:
        """Add the concepts that the corpus does not have yet."""
        rows = [generation.ConceptRow(state.concept, state.title, state.idea, state.data) for state in states]
        generation.add_concepts(self.store, rows)

    def keep_outcome(self, state: ConceptState, stage: str, outcome: StageOutcome) -> None:
        """Store the outcome of a stage. Call it after everything that the stage made is stored."""
        row = generation.OutcomeRow(state.concept, stage, outcome.result, outcome.reason, outcome.facts)
        generation.put_outcome(self.store, row)

    def keep_brief(self, state: ConceptState, text: str, provenance: dict[str, Any]) -> None:
        """Store the brief of a concept."""
        generation.put_brief(self.store, state.concept, text, provenance)

    def keep_attempt(self, state: ConceptState, attempt: Attempt, result: str) -> None:
        """Store an attempt with its source, and its verdict if it was judged.

        Args:
            state: The concept.
            attempt: The attempt.
            result: ``sound``, ``faulty``, ``gutted`` (a degenerate repair), or "" if it was not judged.
        """
        source = self.store.put(attempt.source.encode())
        codes = sorted({code for code, _ in _errors(attempt.report)})
        with self.store.transaction():
            verdict = None
            if attempt.report is not None and self._settings is not None:
                verdict = self.store.insert(source, attempt.env_class, self._settings, attempt.report)
            row = generation.AttemptRow(
                state.concept,
                attempt.number,
                source,
                attempt.env_class,
                attempt.diff,
                result,
                attempt.degenerate,
                " ".join(codes),
                attempt.profile,
                verdict,
                attempt.provenance,
            )
            generation.put_attempt(self.store, row)

    def drop_attempts(self, state: ConceptState, number: int) -> None:
        """Delete the attempts from this number on."""
        generation.delete_attempts(self.store, state.concept, number)

    def keep_policy(self, state: ConceptState, policy: PolicyAttempt) -> None:
        """Store a privileged policy."""
        row = generation.PolicyRow(
            state.concept,
            policy.number,
            policy.source,
            policy.wins,
            policy.episodes,
            policy.fault,
            policy.provenance,
        )
        generation.put_policy(self.store, row)

    def publish(self, state: ConceptState, attempt: Attempt, name: str, origin: dict[str, Any]) -> None:
        """Add an attempt to the corpus as an environment, with its verdict."""
        with self.store.transaction():
            self.store.add(name, attempt.source.encode(), attempt.env_class, origin)
        if attempt.report is not None and self._settings is not None:
            environment = Environment(name, attempt.report.source_sha256, attempt.env_class)
            self.store.record(environment, self._settings, attempt.report)

    def _attempts(self, concept: str) -> list[Attempt]:
        reports = generation.attempt_reports(self.store, concept, self._settings)
        return [
            Attempt(
                row.number,
                self.store.source(row.source).decode("utf-8", "replace"),
                row.env_class,
                row.diff,
                decode(reports[row.number]) if row.number in reports else None,
                # The profile depends on the settings too.
                row.profile if row.number in reports else {},
                row.gutted,
                row.provenance,
            )
            for row in generation.attempts(self.store, concept)
        ]


def history_data(store: Store, concept: str) -> dict[str, Any]:
    """Return the history of a concept as plain data; {} if the concept does not exist.

    Raises:
        CorpusDamaged: If a source is missing or damaged.
    """
    state = History(store).state(concept)
    if state is None:
        return {}
    return {
        "concept": state.concept,
        "title": state.title,
        "words": len(state.brief.split()),
        "outcomes": {stage: msgspec.to_builtins(state.outcomes[stage]) for stage in in_running_order(state.outcomes)},
        "attempts": [
            {
                "number": attempt.number,
                "source": _sha256(attempt.source),
                "verdict": attempt.report.verdict.value if attempt.report else None,
                "findings": [f"{code}: {message}" for code, message in _errors(attempt.report)],
                "gutted": attempt.degenerate,
                "diff": attempt.diff,
                "provenance": attempt.provenance,
            }
            for attempt in state.attempts
        ],
        "policies": [
            {name: getattr(policy, name) for name in ("number", "wins", "episodes", "fault", "provenance")}
            for policy in state.policies
        ],
    }


def history_lines(history: dict[str, Any]) -> list[str]:
    """Return a history, as `history_data` returns it, as lines of text."""
    lines = [f"concept {history['concept']}: {history['title']}, a brief of {history['words']:,} words"]
    for attempt in history["attempts"]:
        verdict = "gutted" if attempt["gutted"] else attempt["verdict"] or "not judged"
        lines.append(f"  attempt {attempt['number']}  {verdict}  {attempt['source'][:12]}")
        lines += [f"    {finding}" for finding in [*attempt["findings"], attempt["gutted"]] if finding]
    for policy in history["policies"]:
        rate = f"wins {policy['wins']} of {policy['episodes']}"
        lines.append(f"  policy {policy['number']}   {policy['fault'] or rate}")
    for stage, outcome in history["outcomes"].items():
        lines.append(f"  {stage:10} {outcome['result']}  {outcome['reason']}".rstrip())
    return lines


def _errors(report: SubjectReport | None) -> list[tuple[str, str]]:
    """Code and message of the findings that fail a check."""
    checks = report.checks if report is not None else []
    return [
        (finding.code, finding.message)
        for check in checks
        for finding in check.findings
        if finding.severity is Severity.ERROR
    ]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
