"""The facets of the gallery: what an environment is sorted by besides its verdict, checks and codes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from envcraft.corpus.report.data import Entry
from envcraft.corpus.report.history import History
from envcraft.model.verdict import CheckReport, Verdict
from envcraft.text import one_line

#: The facets with their labels, in the order of the page.
FACETS = {
    "family": "Family",
    "genre": "Genre",
    "mechanic": "Mechanic",
    "theme": "Theme",
    "stage": "Stage",
    "attempts": "Attempts",
    "difficulty": "Difficulty",
    "speed": "Speed",
}
#: Bounds of the classes of speed in steps per second, with the class below each bound.
_SPEEDS = ((100.0, "under 100/s"), (1_000.0, "100 to 1,000/s"), (10_000.0, "1,000 to 10,000/s"))
_FASTEST = "over 10,000/s"
_DIFFICULTY = "difficulty"
_ALL_PASSED = "all passed"


def values(entry: Entry, history: History | None) -> dict[str, list[str]]:
    """The values of an environment by facet; facets without a value are left out."""
    found: dict[str, list[str]] = {}
    family = entry.origin.get("family")
    if isinstance(family, str):
        found["family"] = [one_line(family)]
    axes = entry.origin.get("axes")
    if isinstance(axes, dict):
        found["mechanic"] = [one_line(words) for words in _choices(axes)]
    if history is not None:
        for kind in ("genre", "mechanic", "theme"):
            found[kind] = history.ingredients(kind)
        found["stage"] = [history.stage or _ALL_PASSED] if history.outcomes else []
        found["attempts"] = [str(len(history.attempts))] if history.attempts else []
    level = entry.origin.get("difficulty", axes.get("difficulty") if isinstance(axes, dict) else None)
    found["difficulty"] = [_level(level)] if isinstance(level, int | float) and not isinstance(level, bool) else []
    report = entry.report
    if report is not None:
        found["difficulty"] += [
            words for check in report.checks if check.check == _DIFFICULTY for words in _difficulty(check)
        ]
        if report.seconds > 0:
            found["speed"] = [speed(report.steps / report.seconds)]
    return {name: words for name, words in found.items() if words}


def _choices(axes: dict[str, Any]) -> Iterator[str]:
    """What a family chose on its axes, in words; an axis may have parts."""
    for axis, chosen in axes.items():
        if isinstance(chosen, str) and chosen:
            yield f"{axis}: {chosen}"
        elif isinstance(chosen, dict):
            yield from (f"{axis} {part}: {word}" for part, word in chosen.items() if isinstance(word, str) and word)


def speed(rate: float) -> str:
    """The class of a number of steps per second."""
    return next((words for bound, words in _SPEEDS if rate < bound), _FASTEST)


def _level(level: float) -> str:
    """The class of the difficulty that a family chose, from 0 to 1."""
    quarter = min(max(int(4 * level), 0), 3) if level == level else 0
    return f"chosen {quarter / 4:g} to {(quarter + 1) / 4:g}"


def _difficulty(check: CheckReport) -> list[str]:
    if check.verdict is Verdict.PASS:
        return ["as promised"]
    return sorted({one_line(finding.code) for finding in check.findings}) or ["not settled"]


class Facets:
    """Numbers the values of all environments, and counts them.

    Args:
        stages: the stages of generation, in the order in which they run.
    """

    def __init__(self, stages: Sequence[str] = ()) -> None:
        self._ordered = {
            "stage": [*map(one_line, stages), _ALL_PASSED],
            "speed": [*(words for _, words in _SPEEDS), _FASTEST],
        }
        self._numbers: dict[str, dict[str, int]] = {name: {} for name in FACETS}
        self._counts: Counter[tuple[str, str]] = Counter()

    def row(self, found: dict[str, list[str]]) -> list[list[int]]:
        """The numbers of an environment's values, a list for each facet."""
        row = []
        for name, numbers in self._numbers.items():
            words = found.get(name, [])
            self._counts.update((name, word) for word in words)
            row.append([numbers.setdefault(word, len(numbers)) for word in words])
        return row

    def legend(self) -> list[dict[str, Any]]:
        """Each facet with its label, its values by number, and the order in which the page lists them."""
        return [self._facet(name, list(numbers)) for name, numbers in self._numbers.items()]

    def _facet(self, name: str, words: list[str]) -> dict[str, Any]:
        known = self._ordered.get(name, [])
        order = sorted(words, key=lambda word: (known.index(word) if word in known else 0, _natural(word)))
        return {
            "name": name,
            "label": FACETS[name],
            "words": words,
            "counts": [self._counts[name, word] for word in words],
            "order": [words.index(word) for word in order],
        }


def _natural(word: str) -> tuple[int, str]:
    return (int(word) if word.isdecimal() else 0, word)
