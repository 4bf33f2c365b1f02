"""Elaboration (optional): a model writes the concept out in full before its brief is written."""

from __future__ import annotations

import re

from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome, StageRequest
from envcraft_llm.extraction import strip_markup
from envcraft_llm.templates import prompt

#: The labels of the parts of the text, in order.
PARTS = ("Controls", "Objects", "Rules", "Win", "Loss", "Picture")
#: Bounds of the length, in words.
WORDS = (200, 800)
_TRIES = 2
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_THOUSANDS = re.compile(r"(?<=\d),(?=\d{3}\b)")
#: A label, with Markdown markup around it.
_PART = re.compile(rf"^[#*_ \t]*({'|'.join(PARTS)})[*_]*:", re.MULTILINE)


class Elaboration(Stage):
    name = "elaboration"
    summary = "The concept written out in full, with every open question decided and every number kept."
    after = "concepts"
    optional = True

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        if state.brief:
            # A brief exists, so an elaboration would have no effect.
            return StageOutcome("passed", facts={"tries": 0})
        template = prompt(self.name)
        messages = [
            ("system", template.fill("System")),
            ("user", template.fill("User", title=state.title, concept=state.idea)),
        ]
        problems: list[str] = []
        for number in range(_TRIES):
            reply = await context.generate(
                state, StageRequest(tuple(messages), self.name, number, prompt=template.sha256)
            )
            text = strip_markup(reply.text).strip()
            problems = complaints(text, state.idea)
            if not problems:
                return StageOutcome("passed", facts={"text": text, "tries": number + 1, **reply.provenance})
            again = template.fill("Again", complaints="\n".join(f"- {problem}" for problem in problems))
            messages += [("assistant", reply.text), ("user", again)]
        return StageOutcome("failed", f"no elaboration: {'; '.join(problems)}", {"tries": _TRIES})


def elaborated_idea(state: ConceptState) -> str:
    """Return the elaborated text of a concept, or its own text if it was not elaborated."""
    outcome = state.outcomes.get(Elaboration.name)
    return str(outcome.facts.get("text", state.idea)) if outcome is not None else state.idea


def complaints(text: str, idea: str) -> list[str]:
    """Return what is wrong with an elaboration, one sentence each; the sentences are part of the retry prompt."""
    parts = [match[1] for match in _PART.finditer(text)]
    wrong = [f"There is no part that begins with `{name}:`." for name in PARTS if name not in parts]
    if not wrong and parts != list(PARTS):
        wrong.append(f"The parts are not in the order {', '.join(PARTS)}, each once.")
    if missing := sorted(_numbers(idea) - _numbers(text), key=float):
        wrong.append(f"Numbers of the concept are missing: {', '.join(missing)}.")
    words = len(text.split())
    if not WORDS[0] <= words <= WORDS[1]:
        wrong.append(f"It has {words:,} words; it has to have {WORDS[0]:,} to {WORDS[1]:,}.")
    return wrong


def _numbers(text: str) -> set[str]:
    return set(_NUMBER.findall(_THOUSANDS.sub("", text)))
