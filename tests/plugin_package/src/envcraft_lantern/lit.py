"""A stage for ``envcraft generate``: only games that mention light are built."""

from __future__ import annotations

import re

from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome


class Lit(Stage):
    name = "lit"
    summary = "The brief says where the light comes from."
    after = "briefs"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        if re.search(r"\b(light|lamp|lantern|sun|glow)", state.brief, re.IGNORECASE):
            return StageOutcome("passed")
        return StageOutcome("rejected", "dark: the brief says nothing of light")
