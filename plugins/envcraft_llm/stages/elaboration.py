"""Elaboration: a model tells the concept in full before its brief is written, where ``--with elaboration`` asks."""

from __future__ import annotations

import re

from envcraft.stages import Case, Outcome, Question, Stage, Workbench
from envcraft_llm.extraction import clean
from envcraft_llm.templates import prompt

#: How the parts of the text begin, in order.
PARTS = ("Controls", "Objects", "Rules", "Win", "Loss", "Picture")
WORDS = (200, 800)
_TRIES = 2
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_THOUSANDS = re.compile(r"(?<=\d),(?=\d{3}\b)")
#: Marks of Markdown around the name of a part.
_PART = re.compile(rf"^[#*_ \t]*({'|'.join(PARTS)})[*_]*:", re.MULTILINE)


class Elaboration(Stage):
    name = "elaboration"
    summary = "The idea told in full: what it leaves open is decided, and every number stays."
    after = "concepts"
    optional = True

    async def run(self, case: Case, bench: Workbench) -> Outcome:
        if case.brief:
            # The brief is what comes of it.
            return Outcome("passed", facts={"tries": 0})
        template = prompt(self.name)
        messages = [
            ("system", template.fill("System")),
            ("user", template.fill("User", title=case.title, concept=case.idea)),
        ]
        wrong: list[str] = []
        for number in range(_TRIES):
            reply = await bench.ask(case, Question(tuple(messages), self.name, number, prompt=template.sha256))
            text = clean(reply.text).strip()
            wrong = complaints(text, case.idea)
            if not wrong:
                return Outcome("passed", facts={"text": text, "tries": number + 1, **reply.provenance})
            again = template.fill("Again", complaints="\n".join(f"- {one}" for one in wrong))
            messages += [("assistant", reply.text), ("user", again)]
        return Outcome("failed", f"no elaboration: {'; '.join(wrong)}", {"tries": _TRIES})


def told(case: Case) -> str:
    """What a concept's brief is written from: its text as it was elaborated, if it was."""
    outcome = case.outcomes.get(Elaboration.name)
    return str(outcome.facts.get("text", case.idea)) if outcome is not None else case.idea


def complaints(text: str, idea: str) -> list[str]:
    """What is wrong with an elaborated concept, each in one sentence that its writer can act on."""
    parts = [found[1] for found in _PART.finditer(text)]
    wrong = [f"There is no part that begins with `{name}:`." for name in PARTS if name not in parts]
    if not wrong and parts != list(PARTS):
        wrong.append(f"The parts are not in the order {', '.join(PARTS)}, each once.")
    if lost := sorted(_numbers(idea) - _numbers(text), key=float):
        wrong.append(f"Numbers of the concept are missing: {', '.join(lost)}.")
    words = len(text.split())
    if not WORDS[0] <= words <= WORDS[1]:
        wrong.append(f"It has {words:,} words; it has to have {WORDS[0]:,} to {WORDS[1]:,}.")
    return wrong


def _numbers(text: str) -> set[str]:
    return set(_NUMBER.findall(_THOUSANDS.sub("", text)))
