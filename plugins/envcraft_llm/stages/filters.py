"""Filters: what random play wins, or doing nothing loses at once, is left out. Nothing is played anew."""

from __future__ import annotations

from envcraft.stages import Case, Outcome, Stage, Workbench
from envcraft.verdict import Verdict
from envcraft_llm.findings import brief_words, findings, verdict_of


class _Filter(Stage):
    """Whether one check fails, as it was judged with all others."""

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        attempt = case.best
        if attempt is None or attempt.report is None:
            return Outcome("failed", "not judged: there is no attempt that was judged")
        if verdict_of(attempt.report, self.name) is Verdict.FAIL:
            found = findings(attempt.report, frozenset({self.name}))
            return Outcome("rejected", f"{self.name}: {brief_words(found)}")
        return Outcome("passed")


class Instawin(_Filter):
    name = "instawin"
    summary = "Random play does not win, and nothing is paid whatever one does."
    after = "repair"


class Instadeath(_Filter):
    name = "instadeath"
    summary = "Doing nothing does not lose at once."
    after = "instawin"
