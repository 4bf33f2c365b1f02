"""How the environments of a corpus came about: concepts, briefs, attempts, policies, and what each stage said.

Everything is keyed by the concept, and written whole: whatever ends the process between two calls, what is read
afterwards is what was kept before.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable
from typing import Any

import msgspec

from envcraft.cli import offered
from envcraft.corpus.settings import Settings
from envcraft.corpus.store import Environment, Store, decode
from envcraft.stages import Attempt, Case, Outcome, PolicyTry, ordered
from envcraft.verdict import Severity, SubjectReport, Verdict, plain

#: The tables whose rows belong to a concept, besides its own.
TABLES = ("briefs", "attempts", "policies", "outcomes")


class History:
    """The tables of generation in an open corpus. Methods that keep something raise OSError, sqlite3.Error."""

    def __init__(self, store: Store, settings: Settings | None = None) -> None:
        """`settings` are those of the verdicts that are kept, and what was judged otherwise counts as not judged; with
        None any verdict is read, and none is kept.
        """
        self.store = store
        self._settings = None if settings is None else store.settings(settings)

    def keep_concepts(self, found: Iterable[Case]) -> None:
        """Add the concepts that are not there yet."""
        with self.store.transaction():
            self.store.db.executemany(
                "INSERT INTO concepts VALUES (?, ?, ?, ?) ON CONFLICT (id) DO NOTHING",
                [(case.concept, case.title, case.idea, _text(case.data)) for case in found],
            )

    def concepts(self) -> list[str]:
        """The ids of all concepts."""
        return [concept for (concept,) in self.store.db.execute("SELECT id FROM concepts ORDER BY id")]

    def case(self, concept: str) -> Case | None:
        """All that is kept of one concept; None for one that is not there. Raises CorpusDamaged."""
        row = self.store.db.execute("SELECT title, text, data FROM concepts WHERE id = ?", (concept,)).fetchone()
        if row is None:
            return None
        brief = self.store.db.execute("SELECT text FROM briefs WHERE concept = ?", (concept,)).fetchone()
        return Case(
            concept,
            row[0],
            row[1],
            json.loads(row[2]),
            brief[0] if brief else "",
            self._attempts(concept),
            self._policies(concept),
            self.outcomes(concept),
        )

    def outcomes(self, concept: str) -> dict[str, Outcome]:
        """By stage, what was said of a concept."""
        found = self.store.db.execute(
            "SELECT stage, result, reason, facts FROM outcomes WHERE concept = ? ORDER BY stage", (concept,)
        )
        return {stage: Outcome(result, reason, json.loads(facts)) for stage, result, reason, facts in found}

    def counts(self, concepts: Iterable[str]) -> dict[str, Counter[str]]:
        """By stage, how many of these concepts had which result."""
        wanted = set(concepts)
        found: dict[str, Counter[str]] = {}
        for concept, stage, result in self.store.db.execute("SELECT concept, stage, result FROM outcomes"):
            if concept in wanted:
                found.setdefault(stage, Counter())[result] += 1
        return found

    def reasons(self, concepts: Iterable[str]) -> dict[str, Counter[str]]:
        """By stage, why concepts came no further, each reason up to its colon."""
        wanted = set(concepts)
        found: dict[str, Counter[str]] = {}
        query = "SELECT concept, stage, reason FROM outcomes WHERE result != 'passed'"
        for concept, stage, reason in self.store.db.execute(query):
            if concept in wanted:
                found.setdefault(stage, Counter())[reason.partition(":")[0]] += 1
        return found

    def yields(self, concepts: Iterable[str]) -> list[tuple[int, int]]:
        """By number of the attempt, how many were judged, and how many of these did what they were meant to and had no
        finding to repair.
        """
        wanted = set(concepts)
        made: Counter[int] = Counter()
        good: Counter[int] = Counter()
        for concept, number, result in self.store.db.execute("SELECT concept, number, result FROM attempts"):
            if concept in wanted and result:
                made[number] += 1
                good[number] += result == "sound"
        return [(made[number], good[number]) for number in range(max(made, default=-1) + 1)]

    # Keeping

    def keep_outcome(self, case: Case, stage: str, outcome: Outcome) -> None:
        """Write down what a stage said, once all that it made is kept."""
        self.store.db.execute(
            "INSERT INTO outcomes VALUES (?, ?, ?, ?, ?) ON CONFLICT (concept, stage) DO UPDATE SET "
            "result = excluded.result, reason = excluded.reason, facts = excluded.facts",
            (case.concept, stage, outcome.result, plain(outcome.reason), _text(outcome.facts)),
        )

    def keep_brief(self, case: Case, text: str, provenance: dict[str, Any]) -> None:
        self.store.db.execute(
            "INSERT INTO briefs VALUES (?, ?, ?) ON CONFLICT (concept) DO UPDATE SET "
            "text = excluded.text, provenance = excluded.provenance",
            (case.concept, text, _text(provenance)),
        )

    def keep_attempt(self, case: Case, attempt: Attempt, result: str) -> None:
        """Keep an attempt with its source, and the verdict on it if it was judged; `result` is ``sound``, ``faulty``,
        ``gutted``, or empty before it was judged.
        """
        source = self.store.put(attempt.source.encode())
        codes = sorted({code for code, _ in _codes(attempt.report)})
        with self.store.transaction():
            verdict = None
            if attempt.report is not None and self._settings is not None:
                verdict = self.store.insert(source, attempt.env_class, self._settings, attempt.report)
            self.store.db.execute(
                "INSERT OR REPLACE INTO attempts VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    case.concept,
                    attempt.number,
                    source,
                    attempt.env_class,
                    attempt.diff,
                    result,
                    attempt.gutted,
                    " ".join(codes),
                    _text(attempt.profile),
                    verdict,
                    _text(attempt.provenance),
                ),
            )

    def drop_attempts(self, case: Case, number: int) -> None:
        """Forget the attempts from this number on."""
        self.store.db.execute("DELETE FROM attempts WHERE concept = ? AND attempts.number >= ?", (case.concept, number))

    def keep_policy(self, case: Case, policy: PolicyTry) -> None:
        self.store.db.execute(
            "INSERT OR REPLACE INTO policies VALUES (?, ?, ?, ?, ?, ?, ?)",
            (
                case.concept,
                policy.number,
                policy.source,
                policy.wins,
                policy.episodes,
                policy.fault,
                _text(policy.provenance),
            ),
        )

    def publish(self, case: Case, attempt: Attempt, name: str, origin: dict[str, Any]) -> None:
        """Make an attempt an environment, with the verdict on it."""
        with self.store.transaction():
            self.store.add(name, attempt.source.encode(), attempt.env_class, origin)
        if attempt.report is not None and self._settings is not None:
            environment = Environment(name, attempt.report.source_sha256, attempt.env_class)
            self.store.record(environment, self._settings, attempt.report)

    def judged(self, attempt: Attempt, case: Case) -> tuple[SubjectReport, dict[str, Any]] | None:
        """The report on, and the profile of, a source of this concept that was judged so before."""
        row = self.store.db.execute(
            "SELECT report, profile FROM attempts JOIN verdicts ON verdicts.id = attempts.verdict WHERE concept = ? "
            "AND number = ? AND attempts.source = ? AND attempts.class = ? AND settings = ? "
            "AND verdicts.verdict != ?",
            (
                case.concept,
                attempt.number,
                _sha256(attempt.source),
                attempt.env_class,
                self._settings,
                Verdict.ERROR.value,
            ),
        ).fetchone()
        return None if row is None else (decode(row[0]), json.loads(row[1]))

    # Reading

    def _attempts(self, concept: str) -> list[Attempt]:
        found = self.store.db.execute(
            "SELECT number, attempts.source, attempts.class, diff, report, profile, gutted, provenance FROM attempts "
            "LEFT JOIN verdicts ON verdicts.id = attempts.verdict AND (settings = ?2 OR ?2 IS NULL) "
            "WHERE concept = ?1 ORDER BY number",
            (concept, self._settings),
        ).fetchall()
        return [
            Attempt(
                number,
                self.store.source(source).decode("utf-8", "replace"),
                env_class,
                diff,
                None if report is None else decode(report),
                # As much was played as the settings say.
                {} if report is None else json.loads(profile),
                gutted,
                json.loads(provenance),
            )
            for number, source, env_class, diff, report, profile, gutted, provenance in found
        ]

    def _policies(self, concept: str) -> list[PolicyTry]:
        found = self.store.db.execute(
            "SELECT number, source, wins, episodes, fault, provenance FROM policies WHERE concept = ? ORDER BY number",
            (concept,),
        )
        return [
            PolicyTry(number, source, wins, episodes, fault, json.loads(provenance))
            for number, source, wins, episodes, fault, provenance in found
        ]


def told(store: Store, concept: str) -> dict[str, Any]:
    """The history of one concept as plain data, for people and programs to read; {} where there is none."""
    case = History(store).case(concept)
    if case is None:
        return {}
    return {
        "concept": case.concept,
        "title": case.title,
        "words": len(case.brief.split()),
        "outcomes": {stage: msgspec.to_builtins(case.outcomes[stage]) for stage in _in_order(case.outcomes)},
        "attempts": [
            {
                "number": attempt.number,
                "source": _sha256(attempt.source),
                "verdict": attempt.report.verdict.value if attempt.report else None,
                "findings": [f"{code}: {words}" for code, words in _codes(attempt.report)],
                "gutted": attempt.gutted,
                "diff": attempt.diff,
                "provenance": attempt.provenance,
            }
            for attempt in case.attempts
        ],
        "policies": [
            {name: getattr(policy, name) for name in ("number", "wins", "episodes", "fault", "provenance")}
            for policy in case.policies
        ],
    }


def words(history: dict[str, Any]) -> list[str]:
    """A history in lines for people."""
    lines = [f"concept {history['concept']}: {history['title']}, a brief of {history['words']:,} words"]
    for attempt in history["attempts"]:
        said = "gutted" if attempt["gutted"] else attempt["verdict"] or "not judged"
        lines.append(f"  attempt {attempt['number']}  {said}  {attempt['source'][:12]}")
        lines += [f"    {finding}" for finding in [*attempt["findings"], attempt["gutted"]] if finding]
    for policy in history["policies"]:
        rate = f"wins {policy['wins']} of {policy['episodes']}"
        lines.append(f"  policy {policy['number']}   {policy['fault'] or rate}")
    for stage, outcome in history["outcomes"].items():
        lines.append(f"  {stage:10} {outcome['result']}  {outcome['reason']}".rstrip())
    return lines


def _in_order(outcomes: Iterable[str]) -> list[str]:
    """Names of stages in the order in which they run; last those that no plugin has any more."""
    names = [stage.name for stage in ordered(offered("envcraft_stages"))]
    return sorted(outcomes, key=lambda name: (names.index(name) if name in names else len(names), name))


def _codes(report: SubjectReport | None) -> list[tuple[str, str]]:
    """The findings that fail a check."""
    checks = report.checks if report is not None else []
    return [
        (finding.code, finding.message)
        for check in checks
        for finding in check.findings
        if finding.severity is Severity.ERROR
    ]


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _text(value: Any) -> str:
    return json.dumps(plain(value), sort_keys=True)
