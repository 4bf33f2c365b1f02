"""Filters: reject games that random play wins, or that doing nothing loses at once; the report decides."""

from __future__ import annotations

from envcraft.generation.stages import Attempt, ConceptState, Stage, StageContext, StageOutcome
from envcraft.model.verdict import Verdict
from envcraft_llm.findings import FILTER_CHECKS, check_verdict, findings, summary_line


async def current_attempt(
    state: ConceptState, context: StageContext, pending: frozenset[str]
) -> Attempt | StageOutcome:
    """Return the best attempt with its report, or an outcome that rejects it.

    An attempt whose report comes from a run with other settings is judged again, and has to pass all checks that come
    before this stage.

    Args:
        state: The concept.
        context: Services of the stage.
        pending: Names of the checks that this stage and later ones decide.
    """
    attempt = state.best
    if attempt is None:
        return StageOutcome("failed", "not judged: no attempt was judged")
    if attempt.report is None:
        await context.judge(state, attempt)
        context.keep_attempt(state, attempt)
        assert attempt.report is not None
        checks = frozenset(check.check for check in attempt.report.checks)
        if failed := findings(attempt.report, checks - pending):
            return StageOutcome("rejected", f"judged again: {summary_line(failed)}", {"attempt": attempt.number})
    return attempt


class _Filter(Stage):
    """Rejects a concept if the check of the stage's name fails.

    Attributes:
        pending: Names of the checks that this stage and later ones decide.
    """

    pending: frozenset[str]

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        attempt = await current_attempt(state, context, self.pending)
        if isinstance(attempt, StageOutcome):
            return attempt
        assert attempt.report is not None
        if check_verdict(attempt.report, self.name) is Verdict.FAIL:
            failed = findings(attempt.report, frozenset({self.name}))
            return StageOutcome("rejected", f"{self.name}: {summary_line(failed)}")
        return StageOutcome("passed")


class Instawin(_Filter):
    name = "instawin"
    summary = "Random play does not win, and the reward depends on play."
    after = "repair"
    pending = FILTER_CHECKS


class Instadeath(_Filter):
    name = "instadeath"
    summary = "Doing nothing does not lose at once."
    after = "instawin"
    pending = FILTER_CHECKS - {"instawin"}
