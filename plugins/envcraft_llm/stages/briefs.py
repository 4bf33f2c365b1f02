"""Briefs: a design document with fixed sections and a bounded length, with one retry if it violates them."""

from __future__ import annotations

import re

from envcraft.generation.stages import ConceptState, Stage, StageContext, StageOutcome, StageRequest
from envcraft_llm.extraction import strip_markup
from envcraft_llm.templates import prompt

from .elaboration import elaborated_idea

#: The sections of a brief, in order.
SECTIONS = (
    "Premise",
    "Core mechanics",
    "World and parameters",
    "Visual design",
    "Controls",
    "Rewards",
    "Termination",
    "Difficulty and strategy",
)
#: Bounds of the length of a brief, in words.
WORDS = (1500, 3000)
#: Minimum length of a section, in words.
_SECTION_WORDS = 15
_TRIES = 2
_FENCED = re.compile(r"\A\s*(`{3,})(?:markdown|md)?[ \t]*\n(.*?)\n?\1\s*\Z", re.DOTALL)
#: The name may end with a closing sequence of "#"; a pattern that excludes it takes quadratic time on spaces.
_HEADING = re.compile(r"^(#{1,6})[ \t]+(\S.*)$", re.MULTILINE)


class Briefs(Stage):
    name = "briefs"
    summary = "A design document of 1,500 to 3,000 words in eight sections."
    after = "concepts"

    async def run(self, state: ConceptState, context: StageContext) -> StageOutcome:
        template = prompt(self.name)
        messages = [
            ("system", template.fill("System")),
            ("user", template.fill("User", title=state.title, concept=elaborated_idea(state))),
        ]
        problems: list[str] = []
        for number in range(_TRIES):
            reply = await context.generate(
                state, StageRequest(tuple(messages), self.name, number, prompt=template.sha256)
            )
            text = tidy(reply.text)
            problems = complaints(text)
            if not problems:
                context.keep_brief(state, text, reply.provenance)
                return StageOutcome("passed", facts={"words": count(text), "tries": number + 1})
            again = template.fill("Again", complaints="\n".join(f"- {problem}" for problem in problems))
            messages += [("assistant", reply.text), ("user", again)]
        return StageOutcome("failed", f"no brief: {'; '.join(problems)}", {"tries": _TRIES})


def tidy(text: str) -> str:
    """Return a completion without reasoning, a fence around the whole text, and words before the title."""
    text = strip_markup(text).strip()
    if fenced := _FENCED.match(text):
        text = fenced[2].strip()
    title = re.search(r"^# \S", text, re.MULTILINE)
    if title is not None and not _HEADING.search(text[: title.start()]):
        text = text[title.start() :]
    return text + "\n"


def count(text: str) -> int:
    """Count the words of a brief, separated by white space as for ``wc``."""
    return len(text.split())


def complaints(text: str) -> list[str]:
    """Return what is wrong with a brief, one sentence each; the sentences are part of the retry prompt."""
    found = []
    headings = [(len(mark[1]), mark[2].rstrip(" \t#"), mark.end()) for mark in _HEADING.finditer(text)]
    if not headings or headings[0][0] != 1:
        found.append("It does not begin with a level-1 heading that gives the title (`# Title`).")
    elif sum(level == 1 for level, _, _ in headings) > 1:
        found.append("It has more than one level-1 heading.")
    sections = [(name, place) for level, name, place in headings if level == 2]
    names = [name for name, _ in sections]
    if names != list(SECTIONS):
        found += [f"The section `## {name}` is missing." for name in SECTIONS if name not in names]
        found += [
            f"There is a level-2 heading `## {name}` that was not requested." for name in names if name not in SECTIONS
        ]
        if not found or sorted(names) == sorted(SECTIONS):
            found.append(f"The sections are not in the order {', '.join(SECTIONS)}, each once.")
    else:
        ends = [place for _, place in sections[1:]] + [len(text)]
        for (name, place), end in zip(sections, ends, strict=True):
            if count(text[place:end]) < _SECTION_WORDS:
                found.append(f"The section `## {name}` has fewer than {_SECTION_WORDS} words.")
    words = count(text)
    if not WORDS[0] <= words <= WORDS[1]:
        found.append(f"It has {words:,} words; it has to have {WORDS[0]:,} to {WORDS[1]:,}.")
    return found
