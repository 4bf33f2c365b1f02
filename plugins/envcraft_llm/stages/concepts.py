"""Concepts: combined from the pools before the run starts; this stage only counts them."""

from __future__ import annotations

from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome


class Concepts(Stage):
    name = "concepts"
    summary = "An idea with its numbers, combined from the pools."

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        return (
            StageOutcome("passed") if state.idea.strip() else StageOutcome("rejected", "empty: the concept has no text")
        )
