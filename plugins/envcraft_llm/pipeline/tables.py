"""What a run comes to, in tables: what each stage took in and gave on, which attempts helped, what it cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from envcraft.corpus.history import History
from envcraft.stages import Stage
from envcraft.stats import Proportion
from envcraft_llm.endpoint.accounts import Accounts

#: So many reasons of a stage are shown.
_REASONS = 6


class Row(NamedTuple):
    """A stage: how many concepts came in, how many passed, were rejected and failed, and why."""

    stage: str
    entered: int
    passed: int
    rejected: int
    failed: int
    reasons: Counter[str]

    @property
    def rate(self) -> Proportion:
        """Of those that came in and are settled, how many passed."""
        return Proportion(self.passed, self.entered)


def rows(history: History, stages: Sequence[Stage], concepts: Iterable[str]) -> list[Row]:
    """A row for each stage, in order."""
    wanted = set(concepts)
    counts, reasons = history.counts(wanted), history.reasons(wanted)
    found = []
    for stage in stages:
        of = counts.get(stage.name, Counter())
        found.append(
            Row(
                stage.name,
                of.total(),
                of["passed"],
                of["rejected"],
                of["failed"],
                reasons.get(stage.name, Counter()),
            )
        )
    return found


def stage_table(found: Sequence[Row]) -> list[str]:
    """The rows as lines of a Markdown table."""
    lines = [
        "| stage | in | out | rejected | failed | pass rate (95% interval) | why not |",
        "|---|--:|--:|--:|--:|--:|---|",
    ]
    for row in found:
        rate = f"{row.rate.estimate:.1%} ({row.rate.low:.1%} to {row.rate.high:.1%})" if row.entered else "-"
        why = ", ".join(f"{reason} {number:,}" for reason, number in row.reasons.most_common(_REASONS))
        lines.append(
            f"| {row.stage} | {row.entered:,} | {row.passed:,} | {row.rejected:,} | {row.failed:,} | {rate} | {why} |"
        )
    first = next((row for row in found if row.entered), None)
    if first is None or first.stage == found[-1].stage:
        return lines
    # What is under way has neither passed nor failed. Where nothing has come to the end yet, no rate means anything.
    settled = found[-1].passed + sum(row.rejected + row.failed for row in found)
    if found[-1].entered or settled == first.entered:
        whole = Proportion(found[-1].passed, settled)
        rate = f"{whole.estimate:.1%} ({whole.low:.1%} to {whole.high:.1%})"
        lines.append(f"| all | {settled:,} | {found[-1].passed:,} | | | {rate} | |")
    return lines


def yield_lines(found: Sequence[tuple[int, int]]) -> list[str]:
    """By attempt, how many of those that were made have nothing left to repair."""
    names = ["first"] + [f"repair {number}" for number in range(1, len(found))]
    return [
        f"{name}: {good:,} of {made:,} ({good / made:.1%}) without a finding"
        for name, (made, good) in zip(names, found, strict=False)
        if made
    ]


def cost_lines(accounts: Accounts | None) -> list[str]:
    """Requests, tokens and cost by stage; nothing where nobody was asked."""
    if accounts is None:
        return []
    used = [*accounts.by_stage.items(), ("all", accounts.total)]
    return [
        f"{stage}: {usage.asked:,} asked, {usage.replayed:,} replayed, {usage.prompt_tokens:,} + "
        f"{usage.completion_tokens:,} tokens, cost {usage.cost:,.4g}"
        for stage, usage in used
        if usage.asked or usage.replayed
    ]
