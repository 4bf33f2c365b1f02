"""Privileged: a policy that reads the game's state, or the checker's search, shows that the game can be won.

The model writes ``act(state)``, which plays in the sandbox beside the environment and may only read its state. A policy
that does not win is rewritten up to three times, with what is wrong with it in the prompt. If no policy wins but the
search does, the environment passes, and the outcome records the disagreement.
"""

from __future__ import annotations

from typing import Any

from envcraft.generation.stages import (
    Attempt,
    ConceptState,
    PolicyAttempt,
    Stage,
    StageContext,
    StageOutcome,
)
from envcraft.model.verdict import Finding, SubjectReport, Verdict
from envcraft_llm import extraction
from envcraft_llm.findings import check_verdict, finding_lines, findings, summary_line, warnings
from envcraft_llm.templates import prompt

from .code import complete
from .filters import current_attempt

#: Number of rewrites of a policy.
REWRITES = 3
_CHECK = frozenset({"difficulty"})
#: Findings about the policy, not about the environment.
_POLICY_CODES = frozenset({"EC804", "EC805", "EC806"})


class Privileged(Stage):
    name = "privileged"
    summary = "A policy that reads the game's state, or a search, wins the game; trivial play does not."
    after = "instadeath"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        attempt = await current_attempt(state, context, _CHECK)
        if isinstance(attempt, StageOutcome):
            return attempt
        assert attempt.report is not None
        # Without an environment to load, a policy would be paid for in vain.
        if check_verdict(attempt.report, "source") is Verdict.FAIL:
            return StageOutcome("rejected", f"no game: {summary_line(findings(attempt.report, frozenset({'source'})))}")
        # A finding of the search is final.
        if failed := findings(attempt.report, _CHECK):
            return _rejected(failed)
        search_wins = check_verdict(attempt.report, "difficulty") is Verdict.PASS
        facts: dict[str, Any] = {"search": search_wins}
        complaint, source = "", ""
        for number in range(REWRITES + 1):
            source, provenance = await self._write(state, context, attempt, number, source, complaint)
            policy = PolicyAttempt(number, source, provenance=provenance)
            played = None
            complaint = "The answer had no policy in it."
            if source:
                complaint, played = await _evaluate(state, context, attempt, policy)
            policy.fault = "" if policy.wins else complaint
            context.keep_policy(state, policy)
            if policy.wins:
                facts |= {"policy": number, "wins": policy.wins, "episodes": policy.episodes}
                return _passed(played, facts)
        facts |= {"policy": None, "disagreement": search_wins}
        if search_wins:
            return _passed(attempt.report, facts)
        reason = next((check.reason for check in attempt.report.checks if check.check == "difficulty"), "")
        message = f"too hard: no policy of {REWRITES + 1} wins, nor does the search ({reason})"
        return StageOutcome("rejected", message, facts)

    async def _write(
        self, state: ConceptState, context: StageContext, attempt: Attempt, number: int, before: str, complaint: str
    ) -> tuple[str, dict[str, object]]:
        """Return the source of a policy, or "" if the completion has none, and its provenance."""
        template = prompt(self.name)
        part = "Again" if before else "User"
        values = {"brief": state.brief, "source": attempt.source.rstrip()}
        if before:
            values |= {"policy": before.rstrip(), "complaint": complaint}
        user = template.fill(part, **values)
        if not before and number:
            user = f"{user}\n\n{template.fill('Nothing')}"
        messages = (("system", template.fill("System")), ("user", user))
        # A prompt may occur again, and without the sample number the journal would replay its completion.
        reply = await complete(state, context, template, messages, self.name, number, sample=number)
        file = extraction.policy(reply.text)
        return ("" if file is None else file.source), reply.provenance


async def _evaluate(
    state: ConceptState, context: StageContext, attempt: Attempt, policy: PolicyAttempt
) -> tuple[str, SubjectReport]:
    """Play a policy, and set its wins and episodes. Return what is wrong with it, as part of the next prompt, and the
    report on the game with it.
    """
    evaluation = await context.play(state, attempt, policy.source)
    about_policy = [
        finding for check in evaluation.report.checks for finding in check.findings if finding.code in _POLICY_CODES
    ]
    policy.wins, policy.episodes = evaluation.wins, evaluation.episodes
    if any(finding.code in ("EC804", "EC805") for finding in about_policy):
        policy.wins = 0
    lines = [*finding_lines(about_policy)]
    if not policy.wins and not lines:
        lines = [
            f"It wins none of {policy.episodes} episodes, though it does better than doing nothing or random play."
        ]
    return "\n".join(f"- {line}" for line in lines), evaluation.report


def _passed(report: SubjectReport | None, facts: dict[str, Any]) -> StageOutcome:
    """The outcome of a game that is won: rejected if lines that pay or end the episode were never reached."""
    unreached = warnings(report, "EC809")
    if unreached:
        return StageOutcome("rejected", f"never reached: {summary_line(unreached)}", facts)
    return StageOutcome("passed", facts=facts)


def _rejected(failed: list[Finding]) -> StageOutcome:
    cause = "too hard" if any(finding.code == "EC801" for finding in failed) else "too easy"
    return StageOutcome("rejected", f"{cause}: {summary_line(failed)}")
