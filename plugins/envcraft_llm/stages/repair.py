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
        standing = first
        for number in range(1, REPAIRS + 1):
            if not to_repair(standing.report):
                return Outcome("passed", facts={"attempt": standing.number})
            repaired = await self._repair(case, bench, standing, number)
            if repaired is None:
                continue
            await bench.judge(case, repaired)
            repaired.gutted = gutted(case.brief, first, standing, repaired)
            bench.keep_attempt(case, repaired)
            if not repaired.gutted:
                standing = repaired
        return _outcome(case, standing)

    async def _repair(self, case: Case, bench: Workbench, standing: Attempt, number: int) -> Attempt | None:
        """Ask for the next attempt; None where the answer has no file."""
        reply = await complete(case, bench, prompt(self.name), asked(case, number), self.name, number)
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


def standing_before(case: Case, number: int) -> Attempt | None:
    """The attempt that the one with this number repairs: the last before it that does not gut the game."""
    return next((one for one in reversed(case.attempts) if one.number < number and not one.gutted), None)


def asked(case: Case, number: int) -> tuple[tuple[str, str], ...]:
    """The request for a repair: the attempt that stands, what was found in it, and what the answer before lacked."""
    template = prompt(Repair.name)
    standing = standing_before(case, number)
    assert standing is not None
    before = next((one for one in case.attempts if one.number == number - 1), None)
    refused = ""
    if before is None:
        refused = "The answer before had no complete file in it."
    elif before.gutted:
        refused = f"The repair before was refused, since it takes the game apart. {before.gutted}."
    user = template.fill(
        "User",
        brief=case.brief,
        source=standing.source.rstrip(),
        findings=told(to_repair(standing.report), standing.source),
        number=number,
        of=REPAIRS,
        refused=refused,
    )
    return ("system", template.fill("System")), ("user", user)


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
