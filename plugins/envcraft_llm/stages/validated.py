"""Validated: what has come through all stages becomes an environment of the corpus, with how it came about."""

from __future__ import annotations

from envcraft.stages import Case, Outcome, Stage, Workbench


class Validated(Stage):
    name = "validated"
    summary = "The environment is in the corpus, with its verdict and its history."
    after = "privileged"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        attempt = case.best
        if attempt is None:
            return Outcome("failed", "not judged: there is no attempt that was judged")
        return Outcome("passed", facts={"environment": bench.publish(case, attempt), "attempt": attempt.number})
