"""Filters: what random play wins, or doing nothing loses at once, is left out. Nothing is played anew."""

from __future__ import annotations

from envcraft.stages import Attempt, Case, Outcome, Stage, Workbench
from envcraft.verdict import Verdict
from envcraft_llm.findings import LATER, brief_words, findings, verdict_of


async def standing(case: Case, bench: Workbench, open_yet: frozenset[str]) -> Attempt | Outcome:
    """The best attempt with its report, or what is wrong with it. One that a run with other settings has judged is
    judged anew, and then has to pass all checks but those that are `open_yet`: this stage's, and the later ones'.
    """
    attempt = case.best
    if attempt is None:
        return Outcome("failed", "not judged: there is no attempt that was judged")
    if attempt.report is None:
        await bench.judge(case, attempt)
        bench.keep_attempt(case, attempt)
        assert attempt.report is not None
        checks = frozenset(check.check for check in attempt.report.checks)
        if wrong := findings(attempt.report, checks - open_yet):
            return Outcome("rejected", f"judged anew: {brief_words(wrong)}", {"attempt": attempt.number})
    return attempt


class _Filter(Stage):
    """Whether one check fails, as it was judged with all others; `open_yet` are the checks from this one on."""

    open_yet: frozenset[str]

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        attempt = await standing(case, bench, self.open_yet)
        if isinstance(attempt, Outcome):
            return attempt
        assert attempt.report is not None
        if verdict_of(attempt.report, self.name) is Verdict.FAIL:
            found = findings(attempt.report, frozenset({self.name}))
            return Outcome("rejected", f"{self.name}: {brief_words(found)}")
        return Outcome("passed")


class Instawin(_Filter):
    name = "instawin"
    summary = "Random play does not win, and nothing is paid whatever one does."
    after = "repair"
    open_yet = LATER


class Instadeath(_Filter):
    name = "instadeath"
    summary = "Doing nothing does not lose at once."
    after = "instawin"
    open_yet = LATER - {"instawin"}
