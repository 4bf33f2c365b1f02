"""A stage for ``envcraft generate``: only games that speak of light are built."""

from __future__ import annotations

import re

from envcraft.stages import Case, Outcome, Stage, Workbench


class Lit(Stage):
    name = "lit"
    summary = "The brief says where the light comes from."
    after = "briefs"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        if re.search(r"\b(light|lamp|lantern|sun|glow)", case.brief, re.IGNORECASE):
            return Outcome("passed")
        return Outcome("rejected", "dark: the brief says nothing of light")
