"""Validated: what has come through all stages becomes an environment of the corpus, with how it came about."""

from __future__ import annotations

from envcraft.stages import Case, Outcome, Stage, Workbench

from .filters import standing


class Validated(Stage):
    name = "validated"
    summary = "The environment is in the corpus, with its verdict and its history."
    after = "privileged"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        attempt = await standing(case, bench, frozenset())
        if isinstance(attempt, Outcome):
            return attempt
        return Outcome("passed", facts={"environment": bench.publish(case, attempt), "attempt": attempt.number})
