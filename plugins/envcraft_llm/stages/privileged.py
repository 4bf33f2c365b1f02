"""Privileged: a policy that reads the source's own state shows that the game can be won; so does the checker's search.

The model writes ``act(state)``, which plays in the sandbox beside the environment and may only read. What is wrong with
it is told, and it is written again, up to three times. Where it never wins and the search does, the environment is
kept, and that they disagree is kept with it.
"""

from __future__ import annotations

from typing import Any

from envcraft.stages import Attempt, Case, Outcome, Played, PolicyTry, Stage, Workbench
from envcraft.verdict import Finding, Verdict
from envcraft_llm import extraction
from envcraft_llm.findings import brief_words, findings, lines_of, verdict_of
from envcraft_llm.templates import prompt

from .code import complete
from .filters import standing

#: So often a policy is written again.
REPAIRS = 3
_CHECK = frozenset({"difficulty"})
#: Findings that are of the policy, not of the environment.
_POLICY_CODES = frozenset({"EC804", "EC805", "EC806"})


class Privileged(Stage):
    name = "privileged"
    summary = "A policy that reads the game's state, or else a search, wins it; nothing trivial does."
    after = "instadeath"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        attempt = await standing(case, bench, _CHECK)
        if isinstance(attempt, Outcome):
            return attempt
        assert attempt.report is not None
        # What cannot be loaded cannot be played, and a policy for it would be paid for in vain.
        if verdict_of(attempt.report, "source") is Verdict.FAIL:
            return Outcome("rejected", f"no game: {brief_words(findings(attempt.report, frozenset({'source'})))}")
        # What the search has settled, no policy unsettles.
        if wrong := findings(attempt.report, _CHECK):
            return _rejected(wrong)
        searched = verdict_of(attempt.report, "difficulty") is Verdict.PASS
        complaint, source = "", ""
        for number in range(REPAIRS + 1):
            source, provenance = await self._written(case, bench, attempt, number, source, complaint)
            tried = PolicyTry(number, source, provenance=provenance)
            complaint = await _try(case, bench, attempt, tried) if source else "The answer had no policy in it."
            tried.fault = "" if tried.wins else complaint
            bench.keep_policy(case, tried)
            if tried.wins:
                told = {"policy": number, "wins": tried.wins, "episodes": tried.episodes, "search": searched}
                return Outcome("passed", facts=told)
        facts: dict[str, Any] = {"policy": None, "search": searched, "disagreement": searched}
        if searched:
            return Outcome("passed", facts=facts)
        reason = next((check.reason for check in attempt.report.checks if check.check == "difficulty"), "")
        return Outcome("rejected", f"too hard: no policy of {REPAIRS + 1} wins, nor does the search ({reason})", facts)

    async def _written(
        self, case: Case, bench: Workbench, attempt: Attempt, number: int, before: str, complaint: str
    ) -> tuple[str, dict[str, object]]:
        """The source of a policy, "" where the answer has none; and where it comes from."""
        template = prompt(self.name)
        part = "Again" if before else "User"
        values = {"brief": case.brief, "source": attempt.source.rstrip()}
        if before:
            values |= {"policy": before.rstrip(), "complaint": complaint}
        user = template.fill(part, **values)
        if not before and number:
            user = f"{user}\n\n{template.fill('Nothing')}"
        messages = (("system", template.fill("System")), ("user", user))
        # The same words again may be asked for the third time, and the journal would give the same answer.
        reply = await complete(case, bench, template, messages, self.name, number, sample=number)
        found = extraction.policy(reply.text)
        return ("" if found is None else found.source), reply.provenance


async def _try(case: Case, bench: Workbench, attempt: Attempt, tried: PolicyTry) -> str:
    """Let a policy play; what is wrong with it, in words for its writer. An environment that the check finds wrong only
    now is left to the end.
    """
    played: Played = await bench.play(case, attempt, tried.source)
    found = [finding for check in played.report.checks for finding in check.findings if finding.code in _POLICY_CODES]
    tried.wins, tried.episodes = played.wins, played.episodes
    if any(finding.code in ("EC804", "EC805") for finding in found):
        tried.wins = 0
    lines = [*lines_of(found)]
    if not tried.wins and not lines:
        lines = [f"It wins none of {tried.episodes} episodes, though it does better than doing nothing or random play."]
    return "\n".join(f"- {line}" for line in lines)


def _rejected(wrong: list[Finding]) -> Outcome:
    words = "too hard" if any(finding.code == "EC801" for finding in wrong) else "too easy"
    return Outcome("rejected", f"{words}: {brief_words(wrong)}")
