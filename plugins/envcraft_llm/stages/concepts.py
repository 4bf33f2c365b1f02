"""Concepts: put together from the pools before anything is asked, so that here they are only counted."""

from __future__ import annotations

from envcraft.stages import Case, Outcome, Stage, Workbench


class Concepts(Stage):
    name = "concepts"
    summary = "An idea with its numbers, put together from the pools."

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        return Outcome("passed") if case.idea.strip() else Outcome("rejected", "empty: the concept has no text")
