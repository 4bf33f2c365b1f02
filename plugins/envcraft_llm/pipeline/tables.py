"""The result of a run in tables: stages, repairs, and requests."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from envcraft.generation.history import History
from envcraft.generation.stages import Stage
from envcraft.judging.statistics import Proportion
from envcraft_llm.endpoint.usage import UsageTracker

#: Number of reasons shown per stage.
_REASONS = 6


class StageRow(NamedTuple):
    """A stage: how many concepts entered, passed, were rejected and failed, and the reasons."""

    stage: str
    entered: int
    passed: int
    rejected: int
    failed: int
    reasons: Counter[str]

    @property
    def rate(self) -> Proportion:
        """The share of concepts that passed."""
        return Proportion(self.passed, self.entered)


def rows(history: History, stages: Sequence[Stage], concepts: Iterable[str]) -> list[StageRow]:
    """Return a row for each stage, in order."""
    ids = set(concepts)
    counts, reasons = history.counts(ids), history.reasons(ids)
    result = []
    for stage in stages:
        count = counts.get(stage.name, Counter())
        result.append(
            StageRow(
                stage.name,
                count.total(),
                count["passed"],
                count["rejected"],
                count["failed"],
                reasons.get(stage.name, Counter()),
            )
        )
    return result


def stage_table(stage_rows: Sequence[StageRow]) -> list[str]:
    """Return the rows as lines of a Markdown table, with 95% Wilson intervals of the pass rates."""
    lines = [
        "| stage | in | out | rejected | failed | pass rate (95% interval) | why not |",
        "|---|--:|--:|--:|--:|--:|---|",
    ]
    for row in stage_rows:
        rate = _rate(row.rate) if row.entered else "-"
        why = ", ".join(f"{reason} {number:,}" for reason, number in row.reasons.most_common(_REASONS))
        lines.append(
            f"| {row.stage} | {row.entered:,} | {row.passed:,} | {row.rejected:,} | {row.failed:,} | {rate} | {why} |"
        )
    first = next((row for row in stage_rows if row.entered), None)
    if first is None or first.stage == stage_rows[-1].stage:
        return lines
    # A concept in progress has neither passed nor failed. Without a concept in the last stage there is no overall rate.
    settled = stage_rows[-1].passed + sum(row.rejected + row.failed for row in stage_rows)
    if stage_rows[-1].entered or settled == first.entered:
        overall = Proportion(stage_rows[-1].passed, settled)
        lines.append(f"| all | {settled:,} | {stage_rows[-1].passed:,} | | | {_rate(overall)} | |")
    return lines


def _rate(proportion: Proportion) -> str:
    return f"{proportion.estimate:.1%} ({proportion.low:.1%} to {proportion.high:.1%})"


def yield_lines(yields: Sequence[tuple[int, int]]) -> list[str]:
    """Return a line per attempt number: how many of those attempts have no finding left to repair."""
    names = ["first"] + [f"repair {number}" for number in range(1, len(yields))]
    return [
        f"{name}: {good:,} of {judged:,} ({good / judged:.1%}) without a finding"
        for name, (judged, good) in zip(names, yields, strict=False)
        if judged
    ]


def usage_lines(usage: UsageTracker | None) -> list[str]:
    """Return a line per stage with its requests, tokens and cost; none if no request was sent or replayed."""
    if usage is None:
        return []
    by_stage = [*usage.by_stage.items(), ("all", usage.total)]
    return [
        f"{stage}: {used.attempts:,} sent, {used.replayed:,} replayed, {used.prompt_tokens:,} + "
        f"{used.completion_tokens:,} tokens, cost {used.cost:,.4g}"
        for stage, used in by_stage
        if used.attempts or used.replayed
    ]
