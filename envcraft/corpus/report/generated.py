"""The section of the report on the stages of generation: how many concepts pass each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

from envcraft.corpus.report.data import Stage
from envcraft.corpus.store import Store, generation
from envcraft.judging.statistics import Proportion
from envcraft.text import one_line

#: The most frequent reasons that a stage shows.
_REASONS = 4


class GenerationStage(NamedTuple):
    """A stage of generation as a filter of concepts, and its most frequent reasons with their counts."""

    filter: Stage
    reasons: list[tuple[str, int]]

    @property
    def rate(self) -> Proportion:
        """The share of concepts that passed."""
        return Proportion(self.filter.left, self.filter.entered)


def generation_stages(store: Store, stages: Sequence[str]) -> list[GenerationStage]:
    """The stages of generation.

    Args:
        store: the corpus.
        stages: the names of its stages, in the order in which they run.
    """
    results: dict[str, Counter[str]] = {stage: Counter() for stage in stages}
    reasons: dict[str, Counter[str]] = {stage: Counter() for stage in stages}
    for _, stage, result, reason in generation.outcome_results(store):
        results[stage][result] += 1
        if result != "passed" and reason:
            reasons[stage][one_line(reason.partition(":")[0])] += 1
    return [
        GenerationStage(
            Stage(one_line(stage), found.total(), found["rejected"], found["failed"], 0, 0),
            reasons[stage].most_common(_REASONS),
        )
        for stage, found in results.items()
    ]
