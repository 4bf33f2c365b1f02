"""Validated: adds the attempt that passed every stage to the corpus, with its verdict and its history."""

from __future__ import annotations

from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome

from .filters import current_attempt


class Validated(Stage):
    name = "validated"
    summary = "The environment is added to the corpus, with its verdict and its history."
    after = "privileged"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        attempt = await current_attempt(state, context, frozenset())
        if isinstance(attempt, StageOutcome):
            return attempt
        return StageOutcome("passed", facts={"environment": context.publish(state, attempt), "attempt": attempt.number})
