"""How an environment was generated: its concept and brief, the stages, the attempts and the policies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from envcraft.corpus.store import Store, generation
from envcraft.corpus.store.generation import AttemptRow, OutcomeRow, PolicyRow
from envcraft.text import one_line, printable

#: Characters of a text that are shown.
_TEXT = 60_000


class History(NamedTuple):
    """The generation of one environment.

    Attributes:
        concept: the id of the concept.
        title: the title of the game.
        text: the concept.
        data: plain data of the generator.
        brief: the text of the brief; empty if there is none.
        outcomes: of the stages, in the order in which they run.
        attempts: in order.
        policies: in order.
    """

    concept: str
    title: str
    text: str
    data: dict[str, Any]
    brief: str
    outcomes: list[OutcomeRow]
    attempts: list[AttemptRow]
    policies: list[PolicyRow]

    @property
    def stage(self) -> str:
        """The stage that stopped the concept; empty if it passed all that ran."""
        return next((one_line(row.stage) for row in self.outcomes if row.result != "passed"), "")

    def ingredients(self, kind: str) -> list[str]:
        """The ingredients of a kind, such as ``theme``, without the kind."""
        return [one_line(name) for found, name in ingredients(self.data) if found == kind]

    def page(self) -> dict[str, Any]:
        """What the page of the environment shows, as plain data whose text is printable."""
        return {
            "concept": one_line(self.concept),
            "title": one_line(self.title),
            "text": _text(self.text),
            "brief": _text(self.brief),
            "stages": [[one_line(row.stage), one_line(row.result), one_line(row.reason)] for row in self.outcomes],
            "attempts": [
                {
                    "number": row.number,
                    "result": one_line(row.result),
                    "gutted": one_line(row.gutted),
                    "codes": one_line(row.codes),
                    "diff": _text(row.diff),
                }
                for row in self.attempts
            ],
            "policies": [
                {
                    "number": row.number,
                    "wins": row.wins,
                    "episodes": row.episodes,
                    "fault": one_line(row.fault),
                    "source": _text(row.source),
                }
                for row in self.policies
            ],
        }


def ingredients(data: dict[str, Any]) -> list[tuple[str, str]]:
    """The kind and the name of each ingredient of a concept, whose plain data this is."""
    listed = data.get("ingredients")
    words = [word for word in listed if isinstance(word, str)] if isinstance(listed, list) else []
    return [(word.partition(":")[0], word.partition(":")[2]) for word in words]


def history(store: Store, origin: dict[str, Any], stages: Sequence[str]) -> History | None:
    """The history of the environment with this origin; None if no concept of the corpus led to it.

    Args:
        store: the corpus.
        origin: of the environment, as plain data.
        stages: all stages with outcomes, in the order in which they run.
    """
    number = origin.get("concept")
    concept = generation.concept(store, number) if isinstance(number, str) else None
    if concept is None:
        return None
    brief = generation.brief(store, concept.concept)
    return History(
        concept.concept,
        concept.title,
        concept.text,
        concept.data,
        "" if brief is None else brief[0],
        sorted(generation.outcomes(store, concept.concept), key=lambda row: stages.index(row.stage)),
        generation.attempts(store, concept.concept),
        generation.policies(store, concept.concept),
    )


def _text(text: str) -> str:
    return printable(text[:_TEXT])
