"""Queries on how environments were generated: concepts, briefs, attempts, policies, and the outcome of each stage."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from envcraft.corpus.store.store import Store
from envcraft.judging.settings import Settings
from envcraft.model.verdict import Verdict, plain

#: The tables whose rows belong to a concept, besides its own.
_TABLES = ("briefs", "attempts", "policies", "outcomes")


class ConceptRow(NamedTuple):
    """A concept; `data` is plain data of its generator."""

    concept: str
    title: str
    text: str
    data: dict[str, Any]


class OutcomeRow(NamedTuple):
    """The outcome of a stage on a concept; `facts` is plain data."""

    concept: str
    stage: str
    result: str
    reason: str
    facts: dict[str, Any]


class AttemptRow(NamedTuple):
    """An attempt at a concept.

    Attributes:
        concept: the concept.
        number: the number of the attempt, from 0.
        source: the SHA-256 of its source in hex.
        env_class: the class to judge.
        diff: the difference from the attempt before.
        result: ``sound``, ``faulty``, ``gutted``, or empty before it was judged.
        gutted: why it is a degenerate repair; empty if it is not.
        codes: the codes of its errors, separated by spaces.
        profile: plain data about its episodes.
        verdict: the row number of the verdict on it.
        provenance: how it was made, plain data.
    """

    concept: str
    number: int
    source: str
    env_class: str
    diff: str
    result: str
    gutted: str
    codes: str
    profile: dict[str, Any]
    verdict: int | None
    provenance: dict[str, Any]


class PolicyRow(NamedTuple):
    """A privileged policy for a concept: its source as text, and how many of its episodes it won."""

    concept: str
    number: int
    source: str
    wins: int
    episodes: int
    fault: str
    provenance: dict[str, Any]


# Reading


def concepts(store: Store) -> list[str]:
    """The ids of all concepts, sorted."""
    return [concept for (concept,) in store.db.execute("SELECT id FROM concepts ORDER BY id")]


def concept_data(store: Store) -> Iterator[dict[str, Any]]:
    """The plain data of each concept."""
    return (json.loads(data) for (data,) in store.db.execute("SELECT data FROM concepts"))


def concept(store: Store, number: str) -> ConceptRow | None:
    """The concept with this id; None if there is none."""
    row = store.db.execute("SELECT id, title, text, data FROM concepts WHERE id = ?", (number,)).fetchone()
    return None if row is None else ConceptRow._make((*row[:3], json.loads(row[3])))


def brief(store: Store, number: str) -> tuple[str, dict[str, Any]] | None:
    """The brief of a concept and its provenance; None if there is none."""
    row = store.db.execute("SELECT text, provenance FROM briefs WHERE concept = ?", (number,)).fetchone()
    return None if row is None else (row[0], json.loads(row[1]))


def briefs(store: Store) -> dict[str, str]:
    """The text of each brief by the id of its concept."""
    return dict(store.db.execute("SELECT concept, text FROM briefs"))


def outcomes(store: Store, number: str | None = None) -> list[OutcomeRow]:
    """The outcomes of a concept, or of all; sorted by stage."""
    cursor = store.db.execute(
        "SELECT concept, stage, result, reason, facts FROM outcomes WHERE ?1 IS NULL OR concept = ?1 ORDER BY stage",
        (number,),
    )
    return [OutcomeRow._make((*row, json.loads(facts))) for *row, facts in cursor]


def stages(store: Store) -> list[str]:
    """The stages that have outcomes, sorted."""
    return [stage for (stage,) in store.db.execute("SELECT DISTINCT stage FROM outcomes ORDER BY stage")]


def outcome_results(store: Store) -> Iterator[tuple[str, str, str, str]]:
    """The concept, stage, result and reason of all outcomes."""
    return store.db.execute("SELECT concept, stage, result, reason FROM outcomes")


def attempts(store: Store, number: str | None = None) -> list[AttemptRow]:
    """The attempts at a concept, or at all; sorted by concept and number."""
    cursor = store.db.execute(
        "SELECT * FROM attempts WHERE ?1 IS NULL OR concept = ?1 ORDER BY concept, number", (number,)
    )
    return [
        AttemptRow._make((*row, json.loads(profile), verdict, json.loads(provenance)))
        for *row, profile, verdict, provenance in cursor
    ]


def attempt_sources(store: Store) -> list[tuple[str, int, str, str]]:
    """The concept, number, source and class of all attempts, sorted."""
    return store.db.execute("SELECT concept, number, source, class FROM attempts ORDER BY concept, number").fetchall()


def attempt_results(store: Store) -> Iterator[tuple[str, int, str]]:
    """The concept, number and result of all attempts."""
    return store.db.execute("SELECT concept, number, result FROM attempts")


def attempt_reports(store: Store, number: str, settings: int | None) -> dict[int, str]:
    """The reports as JSON on the attempts at a concept, by the numbers of the attempts.

    Args:
        store: the corpus.
        number: the id of the concept.
        settings: the row number of the settings that the verdict must have; None for any.
    """
    cursor = store.db.execute(
        "SELECT number, report FROM attempts JOIN verdicts ON verdicts.id = attempts.verdict "
        "WHERE concept = ?1 AND (settings = ?2 OR ?2 IS NULL)",
        (number, settings),
    )
    return dict(cursor)


def attempt_settings(store: Store, number: str) -> dict[int, Settings]:
    """The settings of the verdicts on the attempts at a concept, by the numbers of the attempts."""
    cursor = store.db.execute(
        "SELECT number, contract, contract_sha256, rules, seed, budget, driver, image, settings.checks, offered "
        "FROM attempts JOIN verdicts ON verdicts.id = attempts.verdict "
        "JOIN settings ON settings.id = verdicts.settings WHERE concept = ?",
        (number,),
    )
    return {attempt: Settings(*settings) for attempt, *settings in cursor}


def judged_attempt(
    store: Store, number: str, attempt: int, source: str, env_class: str, settings: int | None
) -> tuple[str, dict[str, Any]] | None:
    """The report as JSON and the profile of an attempt with this source that was judged under these settings.

    Errors do not count. Returns None if there is none.
    """
    row = store.db.execute(
        "SELECT report, profile FROM attempts JOIN verdicts ON verdicts.id = attempts.verdict WHERE concept = ? "
        "AND number = ? AND attempts.source = ? AND attempts.class = ? AND settings = ? AND verdicts.verdict != ?",
        (number, attempt, source, env_class, settings, Verdict.ERROR.value),
    ).fetchone()
    return None if row is None else (row[0], json.loads(row[1]))


def policies(store: Store, number: str) -> list[PolicyRow]:
    """The policies for a concept in the order of their numbers."""
    cursor = store.db.execute("SELECT * FROM policies WHERE concept = ? ORDER BY number", (number,))
    return [PolicyRow._make((*row, json.loads(provenance))) for *row, provenance in cursor]


def progress(store: Store, number: str) -> int | None:
    """How many stages have an outcome on a concept; None if there is no such concept."""
    row = store.db.execute(
        "SELECT count(stage) FROM concepts LEFT JOIN outcomes ON concept = id WHERE id = ? GROUP BY id", (number,)
    ).fetchone()
    return None if row is None else row[0]


# Writing


def add_concepts(store: Store, rows: Iterable[ConceptRow]) -> None:
    """Insert the concepts that are new."""
    with store.transaction():
        store.db.executemany(
            "INSERT INTO concepts VALUES (?, ?, ?, ?) ON CONFLICT (id) DO NOTHING",
            [(*row[:3], _text(row.data)) for row in rows],
        )


def put_brief(store: Store, number: str, text: str, provenance: dict[str, Any]) -> None:
    """Insert or replace the brief of a concept."""
    store.db.execute(
        "INSERT INTO briefs VALUES (?, ?, ?) ON CONFLICT (concept) DO UPDATE SET "
        "text = excluded.text, provenance = excluded.provenance",
        (number, text, _text(provenance)),
    )


def put_outcome(store: Store, row: OutcomeRow) -> None:
    """Insert or replace the outcome of a stage."""
    store.db.execute(
        "INSERT INTO outcomes VALUES (?, ?, ?, ?, ?) ON CONFLICT (concept, stage) DO UPDATE SET "
        "result = excluded.result, reason = excluded.reason, facts = excluded.facts",
        (row.concept, row.stage, row.result, plain(row.reason), _text(row.facts)),
    )


def put_attempt(store: Store, row: AttemptRow) -> None:
    """Insert or replace an attempt."""
    values = row._replace(profile=_text(row.profile), provenance=_text(row.provenance))
    store.db.execute("INSERT OR REPLACE INTO attempts VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", values)


def put_policy(store: Store, row: PolicyRow) -> None:
    """Insert or replace a policy."""
    values = row._replace(provenance=_text(row.provenance))
    store.db.execute("INSERT OR REPLACE INTO policies VALUES (?, ?, ?, ?, ?, ?, ?)", values)


def delete_attempts(store: Store, number: str, first: int) -> None:
    """Delete the attempts at a concept from a number on."""
    store.db.execute("DELETE FROM attempts WHERE concept = ? AND attempts.number >= ?", (number, first))


def copy_concept(store: Store, other: Store, number: str, verdicts: dict[int, int]) -> None:
    """Replace a concept and all its rows by those of another corpus, inside a transaction.

    Args:
        store: the corpus to write.
        other: the corpus to read.
        number: the id of the concept.
        verdicts: the row numbers of verdicts in `store` by those in `other`.
    """
    store.db.execute("DELETE FROM concepts WHERE id = ?", (number,))
    for table, key in (("concepts", "id"), *((table, "concept") for table in _TABLES)):
        cursor = other.db.execute(f"SELECT * FROM {table} WHERE {key} = ?", (number,))
        columns = [column[0] for column in cursor.description]
        for values in cursor:
            row = dict(zip(columns, values, strict=True))
            if table == "attempts":
                row["verdict"] = verdicts.get(row["verdict"])
            store.db.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(row))})", tuple(row.values()))


def _text(value: Any) -> Any:
    return json.dumps(plain(value), sort_keys=True)
