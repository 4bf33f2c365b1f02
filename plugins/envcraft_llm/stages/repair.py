"""Test and repair: all checks, and up to three repairs by what they found. A repair that guts the game is none."""

from __future__ import annotations

import difflib

from envcraft.stages import Attempt, Case, Outcome, Stage, Workbench
from envcraft_llm import extraction
from envcraft_llm.findings import brief_words, to_repair, told
from envcraft_llm.guard import gutted
from envcraft_llm.templates import prompt

from .code import complete

#: So often an environment is repaired.
REPAIRS = 3


class Repair(Stage):
    name = "repair"
    summary = "All checks; what they find is repaired, up to three times, without gutting the game."
    after = "code"

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        first = case.attempts[0]
        bench.drop_attempts(case, first.number + 1)
        await bench.judge(case, first)
        bench.keep_attempt(case, first)
        standing, why = first, ""
        for number in range(1, REPAIRS + 1):
            found = to_repair(standing.report)
            if not found:
                return Outcome("passed", facts={"attempt": standing.number})
            repaired = await self._repair(case, bench, standing, why, number)
            if repaired is None:
                why = "The answer before had no complete file in it."
                continue
            await bench.judge(case, repaired)
            repaired.gutted = gutted(case.brief, first, standing, repaired)
            bench.keep_attempt(case, repaired)
            why = ""
            if repaired.gutted:
                why = f"The repair before was refused, since it takes the game apart. {repaired.gutted}."
            else:
                standing = repaired
        return _outcome(case, standing)

    async def _repair(self, case: Case, bench: Workbench, standing: Attempt, why: str, number: int) -> Attempt | None:
        """Ask for the next attempt; None where the answer has no file."""
        template = prompt(self.name)
        user = template.fill(
            "User",
            brief=case.brief,
            source=standing.source.rstrip(),
            findings=told(to_repair(standing.report), standing.source),
            number=number,
            of=REPAIRS,
            refused=why,
        )
        messages = (("system", template.fill("System")), ("user", user))
        reply = await complete(case, bench, template, messages, self.name, number)
        found = extraction.environment(reply.text)
        if found is None:
            return None
        diff = "".join(
            difflib.unified_diff(
                standing.source.splitlines(keepends=True),
                found.source.splitlines(keepends=True),
                f"attempt {standing.number}",
                f"attempt {number}",
            )
        )
        return Attempt(number, found.source, found.name, diff, provenance=reply.provenance)


def _outcome(case: Case, standing: Attempt) -> Outcome:
    """What the last attempt that stands says, and where it says nothing good, why."""
    found = to_repair(standing.report)
    facts = {"attempt": standing.number, "codes": sorted({finding.code for finding in found})}
    if not found:
        return Outcome("passed", facts={"attempt": standing.number})
    passing = next((one for one in case.attempts if one.gutted and not to_repair(one.report)), None)
    if passing is not None:
        return Outcome("rejected", f"gutted: attempt {passing.number} passes by being less ({passing.gutted})", facts)
    return Outcome("rejected", f"unfixable: {brief_words(found)}", facts)
