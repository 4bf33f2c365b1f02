"""Test and repair: runs all checks, and has up to three repairs made from their findings.

A degenerate repair (:mod:`envcraft_llm.degenerate`) is rejected.
"""

from __future__ import annotations

import difflib

from envcraft.generation.stages import Attempt, ConceptState, Stage, StageContext, StageOutcome
from envcraft_llm import extraction
from envcraft_llm.degenerate import degenerate_reason
from envcraft_llm.findings import findings_markdown, summary_line, to_repair
from envcraft_llm.templates import prompt

from .code import complete

#: Number of repairs.
REPAIRS = 3


class Repair(Stage):
    name = "repair"
    summary = "All checks; their findings are repaired, up to three times, without degenerate repairs."
    after = "code"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        first = state.attempts[0]
        context.drop_attempts(state, first.number + 1)
        await context.judge(state, first)
        context.keep_attempt(state, first)
        current = first
        for number in range(1, REPAIRS + 1):
            if not to_repair(current.report):
                return StageOutcome("passed", facts={"attempt": current.number})
            repaired = await self._repair(state, context, current, number)
            if repaired is None:
                continue
            await context.judge(state, repaired)
            repaired.degenerate = degenerate_reason(state.brief, first, current, repaired)
            context.keep_attempt(state, repaired)
            if not repaired.degenerate:
                current = repaired
        return _outcome(state, current)

    async def _repair(
        self, state: ConceptState, context: StageContext, current: Attempt, number: int
    ) -> Attempt | None:
        """Request the next attempt; None if the completion has no file."""
        reply = await complete(state, context, prompt(self.name), request_messages(state, number), self.name, number)
        file = extraction.environment(reply.text)
        if file is None:
            return None
        diff = "".join(
            difflib.unified_diff(
                current.source.splitlines(keepends=True),
                file.source.splitlines(keepends=True),
                f"attempt {current.number}",
                f"attempt {number}",
            )
        )
        return Attempt(number, file.source, file.name, diff, provenance=reply.provenance)


def parent_of(state: ConceptState, number: int) -> Attempt | None:
    """Return the attempt that the one with this number repairs: the last one before it that is not degenerate."""
    return next((one for one in reversed(state.attempts) if one.number < number and not one.degenerate), None)


def request_messages(state: ConceptState, number: int) -> tuple[tuple[str, str], ...]:
    """Return the messages that request a repair: the parent with its findings, and why the last repair was rejected."""
    template = prompt(Repair.name)
    parent = parent_of(state, number)
    assert parent is not None
    before = next((one for one in state.attempts if one.number == number - 1), None)
    refused = ""
    if before is None:
        refused = "The answer before had no complete file in it."
    elif before.degenerate:
        refused = f"The repair before was refused, since it takes the game apart. {before.degenerate}."
    user = template.fill(
        "User",
        brief=state.brief,
        source=parent.source.rstrip(),
        findings=findings_markdown(to_repair(parent.report), parent.source),
        number=number,
        of=REPAIRS,
        refused=refused,
    )
    return ("system", template.fill("System")), ("user", user)


def _outcome(state: ConceptState, current: Attempt) -> StageOutcome:
    failed = to_repair(current.report)
    facts = {"attempt": current.number, "codes": sorted({finding.code for finding in failed})}
    if not failed:
        return StageOutcome("passed", facts={"attempt": current.number})
    passing = next((one for one in state.attempts if one.degenerate and not to_repair(one.report)), None)
    if passing is not None:
        return StageOutcome(
            "rejected", f"gutted: attempt {passing.number} passes by doing less ({passing.degenerate})", facts
        )
    return StageOutcome("rejected", f"unfixable: {summary_line(failed)}", facts)
